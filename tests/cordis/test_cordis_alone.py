"""A hand on a single link: not a bit of its force is changed by what else a scene has."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from hapsim.cordis.offline import start, tick, update_parameters
from hapsim.cordis.program import compile_scene, parameter_values
from hapsim.scene import Scene

SAMPLES = 400
RATE, K, B = 1000.0, 800.0, 3.0
DISTANCE, RELEASE, FORCE, BRISTLE, BRISTLE_DAMPING, CUTOFF = 0.002, 0.004, 1.0, 3000.0, 1.0, 80.0
OVER_DISTANCE = [[-0.01, -3.0], [0.0, 0.0], [0.01, 5.0]]
OVER_VELOCITY = [[-0.1, -1.0], [0.1, 1.0]]
DAMPERS = ("backward", "centred", "filtered", "sensed")
LINKS: dict[str, dict[str, Any]] = {
    f"viscoelastic, {damper}": {"type": "viscoelastic", "stiffness": K, "damping": B, "damper": damper}
    | ({"cutoff": CUTOFF} if damper == "filtered" else {})
    for damper in DAMPERS
} | {
    "spring": {"type": "spring", "stiffness": K},
    "damper": {"type": "damper", "damping": B},
    "buffer": {"type": "buffer", "stiffness": K, "damping": B, "distance": DISTANCE},
    "friction": {"type": "friction", "force": FORCE, "stiffness": BRISTLE, "damping": BRISTLE_DAMPING},
    "plectrum": {"type": "plectrum", "stiffness": K, "damping": B, "release": RELEASE},
    "detent": {"type": "detent", "pitch": 0.0023, "depth": FORCE, "damping": B},
    "click": {"type": "click", "travel": 0.0031, "peak": FORCE, "drop": 0.7, "bottom": K, "damping": B},
    "nonlinear": {"type": "nonlinear", "force_over_distance": OVER_DISTANCE, "force_over_velocity": OVER_VELOCITY},
}
PRECISIONS = ("double", "single")
AMONG_OTHERS: dict[str, Any] = {
    "other": {"type": "device", "channel": 1},
    "ball": {"type": "mass", "mass": 0.1, "velocity": 0.3},
    "held": {"type": "cell", "mass": 0.1, "stiffness": 50.0},
    "s": {"type": "string", "masses": 20, "mass": 0.01, "stiffness": 100.0},
    "by_ball": {"type": "viscoelastic", "between": ["other", "ball"], "stiffness": 300.0, "damping": 1.0},
    "by_string": {"type": "spring", "between": ["other", "s.3"], "stiffness": 20.0},
    "stop": {"type": "buffer", "between": ["ball", "held"], "stiffness": 200.0},
}


def scene_of(name: str, precision: str, **more: Any) -> Scene:
    modules = {
        "hand": {"type": "device", "channel": 0},
        "wall": {"type": "ground", "position": 0.001},
        "link": {"between": ["hand", "wall"], **LINKS[name]},
    }
    keys = {"version": 1, "rate": RATE, "precision": precision, "device": {"mass": 0.2}}
    return Scene.model_validate({**keys, "modules": modules | more})


def hand_and_ground() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The hand trembles, at the speed that it has, at a ground that is moved four times: m, m/s, m."""
    rng = np.random.default_rng(7)
    hand = 0.003 * np.sin(0.05 * np.arange(SAMPLES)) + 1e-4 * rng.normal(size=SAMPLES)
    ground = np.full(SAMPLES, 0.001)
    for n, place in ((100, -0.002), (101, -0.0021), (250, 0.0015), (300, 0.0016)):
        ground[n:] = place
    return hand, RATE * np.diff(hand, prepend=hand[0]), ground


def played(scene: Scene) -> np.ndarray:
    """The force on the hand, sample by sample."""
    program, values = compile_scene(scene), parameter_values(scene)
    assert program.force.size == program.rows.shape[1]
    rest = int(np.flatnonzero(values == values.dtype.type(0.001))[0])
    hand, speed, ground = hand_and_ground()
    measured, velocity, force = np.zeros((3, scene.channels))
    measured[0] = hand[0]
    start(program, measured)
    forces = np.empty(SAMPLES)
    for n in range(SAMPLES):
        if ground[n] != ground[n - 1] and n > 0:
            values[rest] = ground[n]
            program.parameters.post(values, 1)
        measured[0], velocity[0] = hand[n], speed[n]
        measured[1:] = 0.01 * np.sin(0.03 * n)
        update_parameters(program)
        tick(program, measured, velocity, force)
        forces[n] = force[0]
    return forces


@pytest.mark.thorough(keep=8)
@pytest.mark.parametrize("precision", PRECISIONS)
@pytest.mark.parametrize("name", LINKS)
def test_what_else_a_scene_has_changes_no_bit_of_a_link(name: str, precision: str) -> None:
    alone, among_others = scene_of(name, precision), scene_of(name, precision, **AMONG_OTHERS)
    np.testing.assert_array_equal(played(alone), played(among_others))


@pytest.mark.parametrize("name", LINKS)
def test_single_precision_is_worked_out_in_single_precision(name: str) -> None:
    double, single = (played(scene_of(name, precision)) for precision in PRECISIONS)
    assert not np.array_equal(double, single)
    np.testing.assert_array_equal(single, single.astype(np.float32))
