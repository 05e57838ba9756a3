"""Runs of scenes with the force law on the board beside the loop that is written out: random scenes on the mock."""

import contextlib
import os
from typing import Any

import numpy as np
import pytest

from firmware_protocol.lines import as_sent
from hapsim.device.mock.assemble_mock import describe_mock
from hapsim.running import run
from hapsim.scene import Scene
from tests.board_loops import T, Written, one_sample, random_scene

TICKS = 150
LIMIT, COUNT = 33.0, 1e-6  # N; of the force on the wire
SCENES = int(os.environ.get("HAPSIM_POINTS", "15"))


def scene_of(written: Written, velocities: list[float]) -> Scene:
    """Returns the scene, on a mock with counts of a nanometre."""
    steps, delay, window = written.board
    hands = [f"hand{i}" for i in range(len(written.masses))]
    names = [*hands, *(f"mass{i}" for i in range(len(written.points))), "wall"]
    modules: dict[str, Any] = {name: {"type": "device", "channel": i} for i, name in enumerate(hands)}
    modules |= {f"mass{i}": {"type": "mass", "mass": mass} for i, mass in enumerate(written.points)}
    modules["wall"] = {"type": "ground"}
    for i, (a, b, K, B) in enumerate(written.links):
        link = {"type": "viscoelastic", "between": [names[a], names[b]], "stiffness": K, "damping": B}
        modules[f"link{i}"] = link
    device = {"mass": written.masses, "friction": written.frictions, "stiffness": written.springs, "force_limit": LIMIT}
    device |= {"clock": "lockstep", "delay": written.late / steps, "law": "board", "board_rate": steps / T}
    device |= {"board_delay": delay, "board_window": window}
    mock = {"initial": {"velocity": velocities}, "quantum": 1e-9}
    whole = {"version": 1, "rate": 1.0 / T, "device": device, "mock": mock, "modules": modules}
    return Scene.model_validate(whole)


def drawn(rng: np.random.Generator) -> tuple[Written, list[float], Scene]:
    """A random scene whose lines the mock takes, as it carries them, the hands' velocities, and the scene."""
    while True:
        written = random_scene(rng)
        hands = range(len(written.masses))
        scene = scene_of(written, velocities := rng.uniform(-0.3, 0.3, len(hands)).tolist())
        lines = describe_mock(scene).lines
        assert lines is not None
        k, b = ([sum(link[i] for link in written.links if hand in link[:2]) for hand in hands] for i in (2, 3))
        with contextlib.suppress(ValueError):
            sent = tuple(as_sent(k[hand], b[hand], lines, hand) for hand in hands)
            return written._replace(sent=sent), velocities, scene


@pytest.mark.thorough(keep=5)
@pytest.mark.parametrize("number", range(SCENES))
def test_a_run_is_the_loop_that_is_written_out(number: int) -> None:
    """Within 1e-6 and some counts of position and force; k and b as sent, and no force before the first line."""
    written, velocities, scene = drawn(np.random.default_rng([72, number]))
    trace = run(scene, duration=TICKS * T, unstable=True)
    step = one_sample(written)
    state, places = np.zeros(len(step)), []
    state[1 : 2 * len(velocities) : 2] = velocities
    for n in range(TICKS):
        places.append(state[: 2 * len(velocities) : 2])
        late = written.late - n * written.board.steps
        state = (one_sample(written, late) if late > 0 else step) @ state
    clipped = np.flatnonzero(np.abs(trace.force[:TICKS]).max(axis=1) > 0.5 * LIMIT)
    most = int(clipped[0]) if clipped.size else TICKS  # an unstable scene reaches the limit
    assert most > 20
    off, way = (np.abs(one[:most]).max() for one in (trace.position[:TICKS] - places, np.array(places)))
    assert off < 1e-6 * way + 2e-8 + 3.0 * COUNT / min(k for k, _ in written.sent)
