"""Two mocks with clocks of their own, in virtual time: they move as the theory's loop says, sample by sample."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim.prediction.predict_ports import AcrossPorts, PortsPrediction
from hapsim.running.run import traces_to_end
from hapsim.scene import Scene
from hapsim.theory.network.phases import at_phases
from hapsim.theory.sample import loop
from tests import thorough

SAMPLES, FINE = 40, 1e-12  # m per count


def random_scene(random: np.random.Generator) -> tuple[Scene, float, list[float]]:
    """Returns a scene of two devices with a hand or two each and up to two masses, the phase of the second clock, and
    the initial velocities of the first device's hands."""
    hands = {"left": int(random.integers(1, 3)), "right": int(random.integers(1, 3))}
    points = [f"{port}-{c}" for port, count in hands.items() for c in range(count)]
    masses = [f"m{i}" for i in range(random.integers(0, 3))]
    modules: dict[str, Any] = {
        f"{port}-{c}": {"type": "device", "of": port, "channel": c}
        for port, count in hands.items()
        for c in range(count)
    }
    modules |= {name: {"type": "mass", "mass": random.uniform(0.02, 0.2)} for name in masses} | {
        "g": {"type": "ground"}
    }
    ends = [("left-0", "right-0"), *((a, b) for a in masses for b in ("left-0", "right-0"))]
    ends += [(a, str(random.choice([*points, *masses, "g"]))) for a in points[1:] if random.random() < 0.7]
    for i, (a, b) in enumerate(ends):
        link = {"stiffness": random.uniform(50.0, 800.0), "damping": random.uniform(0.0, 3.0)}
        damper = {"damper": "filtered", "cutoff": 100.0} if random.random() < 0.3 else {}
        if a != b:
            modules[f"link{i}"] = {"type": "viscoelastic", "between": [a, b], **link, **damper}
    devices = {
        port: {
            "mass": random.uniform(0.05, 0.5, count).tolist(),
            "friction": random.uniform(0.1, 3.0, count).tolist(),
            "delay": float(random.choice([0.0, 0.4, 1.0, 1.5])),
            "hold": str(random.choice(["zoh", "impulse"])),
            "sampling": str(random.choice(["ideal", "average"])) if port == "right" else "ideal",  # at rest before
            "clock": "lockstep",
            "force_limit": 10.0,
            "energy_limit": 1e6,
        }
        for port, count in hands.items()
    }
    phase, velocities = float(random.uniform(0.0, 1.0)), random.uniform(0.01, 0.02, hands["left"]).tolist()
    mocks = {"left": {"quantum": FINE, "initial": {"velocity": velocities}}, "right": {"quantum": FINE, "phase": phase}}
    leader = str(random.choice(["left", "right"]))
    data = {"version": 1, "rate": 1000, "devices": devices, "mocks": mocks, "leader": leader, "modules": modules}
    return Scene.model_validate(data), phase, velocities


@pytest.mark.parametrize("seed", range(thorough.points(2, 20)))
def test_random_hands_on_two_ports_move_as_predicted(seed: int) -> None:
    scene, phase, velocities = random_scene(np.random.default_rng(seed))
    traces = traces_to_end(scene, duration=SAMPLES / scene.rate)
    across = next(one for one in PortsPrediction(scene, with_margins=False).every if isinstance(one, AcrossPorts))
    hands = [*across.scene.device_points]
    change, points, *_ = loop(at_phases(across.network, (0.0, phase)))
    state, begin = np.zeros(len(change)), len(points)
    for c, name in enumerate(hands):
        if scene.device_points[name].of == "left":
            state[begin + c] = velocities[scene.device_points[name].channel] / scene.rate
    expected = np.empty((SAMPLES, len(hands)))
    for row in expected:
        row[:] = points[: len(hands)] @ state
        state = state + change @ state
    for c, name in enumerate(hands):
        point = scene.device_points[name]
        measured = traces[str(point.of)].position[:SAMPLES, point.channel]
        assert len(measured) >= SAMPLES - 1
        assert measured == pytest.approx(expected[: len(measured), c], rel=0.0, abs=1e-6 * np.abs(expected).max())
