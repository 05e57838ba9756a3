"""The modules move several times between two samples, the hand on a line; the last force leaves, or the mean."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_rig import POSITION_SCALE, arrive, assembled, frame
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.endings import RECEIVED
from hapsim.running import requirements, start
from hapsim.running.changes import LiveScene
from hapsim.scene import Scene
from tests import one_hand
from tests.one_hand import touch

RATE, MASS = 1000.0, 0.01
TOUCH, PULL, BACK = (2000.0, 5.0), (900.0, 2.0), (3000.0, 0.5)  # N/m, N·s/m
ARRIVALS = [(7, 2000), (8, 2300), (9, 2100), (12, 2700), (13, 2650), (14, 1000)]  # two positions are lost after the 9th


def scene_of(substeps: int, decimation: str, **differences: Any) -> Scene:
    """A hand on a wall, and on a mass that hangs on it too."""
    links = {"touch": (["hand", "wall"], TOUCH), "pull": (["hand", "ball"], PULL), "back": (["ball", "wall"], BACK)}
    modules: dict[str, Any] = {name: touch(k, b, between=ends) for name, (ends, (k, b)) in links.items()}
    modules["wall"] = {"type": "ground", "position": 0.001}
    modules["ball"] = {"type": "mass", "mass": MASS, "position": 0.0015, "velocity": 0.02}
    device = {"decimation": decimation} | differences
    return one_hand.scene_of(modules, device=device, substeps=substeps)


def worked_out(substeps: int, decimation: str, touch: NDArray[np.float64] | None = None) -> list[float]:
    """The force after each arrival, step by step. `touch`: the first link's stiffness in each step."""
    step_s = 1.0 / (RATE * substeps)
    here, before = 0.0015, 0.0015 - 0.02 * step_s
    last, last_number = ARRIVALS[0][1] * POSITION_SCALE, ARRIVALS[0][0] - 1
    forces, steps, hand = [], 0, last
    for number, counts in ARRIVALS:
        target, count = counts * POSITION_SCALE, (number - last_number) * substeps
        sent = []
        for j in range(1, count + 1):
            hand_before, hand = hand, last + (target - last) * j / count
            way, ball_way = hand - hand_before, here - before
            stiffness = TOUCH[0] if touch is None else touch[min(steps, touch.size - 1)]
            on_wall = stiffness * (hand - 0.001) + TOUCH[1] * way / step_s
            on_ball = PULL[0] * (hand - here) + PULL[1] * (way - ball_way) / step_s
            back = BACK[0] * (here - 0.001) + BACK[1] * ball_way / step_s
            here, before = 2 * here - before + (on_ball - back) * step_s**2 / MASS, here
            sent.append(-on_wall - on_ball)
            steps += 1
        forces.append(sent[-1] if decimation == "last" else float(np.mean(sent[-substeps:])))
        last, last_number = target, number
    return forces


def eased(s: NDArray[np.float64]) -> NDArray[np.float64]:
    return 3 * s**2 - 2 * s**3


def answered(scene: Scene, change: Any = None) -> list[float]:
    """Returns the requested force after each arrival."""
    loop = assembled(scene)
    if change is not None:
        change(LiveScene(scene, loop))
    forces = []
    for i, (number, counts) in enumerate(ARRIVALS):
        assert arrive(loop, frame(number, counts), 1 + i * 1_000_000) == RECEIVED
        forces.append(float(loop.record.io.asked[0]))
    return forces


@pytest.mark.parametrize("decimation", ["last", "mean"])
@pytest.mark.parametrize("substeps", [1, 2, 7])
def test_the_force_is_that_of_the_steps_along_the_line(substeps: int, decimation: str) -> None:
    found = answered(scene_of(substeps, decimation))
    np.testing.assert_allclose(found, worked_out(substeps, decimation), rtol=1e-12)


def test_a_ramp_lasts_as_long_as_without_substeps_and_moves_in_every_step() -> None:
    samples, substeps = 4, 5
    found = answered(
        scene_of(substeps, "mean"), lambda live: live.set({"touch": {"stiffness": 1000.0}}, samples / RATE)
    )
    steps = samples * substeps
    ramp = TOUCH[0] - 1000.0 * eased(np.arange(1, steps + 1) / steps)
    np.testing.assert_allclose(found, worked_out(substeps, "mean", ramp), rtol=1e-12)


def test_a_crossfade_lasts_as_long_as_without_substeps() -> None:
    softer = TOUCH[0] / 2
    scene = scene_of(5, "last")
    without = scene.model_dump(exclude_unset=True)
    without["modules"] = dict(without["modules"]) | {
        "touch": {"type": "viscoelastic", "between": ["hand", "wall"], "stiffness": softer, "damping": TOUCH[1]},
        "more": {"type": "ground"},
    }
    found = answered(scene, lambda live: live.adopt(Scene.model_validate(without), 4 / RATE))
    ramp = TOUCH[0] - softer * eased(np.arange(1, 21) / 20)  # what both scenes have ramps too
    whole, other = worked_out(5, "last"), worked_out(5, "last", ramp)
    weights = eased(np.array([0.25, 0.5, 0.75, 1.0, 1.0, 1.0]))
    np.testing.assert_allclose(found, whole + weights * (np.array(other) - whole), rtol=1e-9)


def test_a_centred_damper_is_refused_with_substeps() -> None:
    modules = {"touch": touch(100.0, 1.0, damper="centred")}
    with pytest.raises(ValueError, match=r"damper: found centred in a scene with substeps"):
        one_hand.scene_of(modules, substeps=4)
    one_hand.scene_of(modules)


def test_substeps_that_take_longer_than_the_sample_period_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(requirements, "tick_seconds", lambda *_: 1e-5)
    with pytest.raises(UsageError, match=r"found 200, whose steps take 2 ms here; .* is 1 ms; .* most 80"):
        start(scene_of(200, "last", clock="device"))
    requirements.require_in_time(scene_of(90, "last", clock="device"))
    requirements.require_in_time(scene_of(200, "last"), is_virtual=True)  # virtual time waits
