"""Pick-ups hear every step, through a high-pass and a soft clip, into a ring that the loop never waits for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from loop_rig import POSITION_SCALE, arrive, assembled, frame
from numpy.typing import NDArray

from hapsim.cordis.offline import start, tick
from hapsim.cordis.program import compile_scene, positions_of
from hapsim.errors import UsageError
from hapsim.loop.endings import RECEIVED
from hapsim.loop.sound import KNEE
from hapsim.running.assemble_loop import LoopMemory
from hapsim.running.changes import LiveScene
from hapsim.scene import Scene

SUBSTEPS, RATE = 6, 1000.0
STEP_RATE = SUBSTEPS * RATE
SOUND: dict[str, Any] = {
    "ball": {"from": "ball", "of": "velocity", "gain": 2.0},
    "gut": {"from": "gut.2", "of": "position", "gain": 30.0, "highpass": 50.0},
    "push": {"from": "hand", "of": "force", "gain": 0.01},
}


def scene_of(sound: dict[str, Any] | None = None, **differences: Any) -> Scene:
    """A hand on a ball, and a plucked string by itself."""
    modules = {
        "hand": {"type": "device", "channel": 0},
        "ball": {"type": "mass", "mass": 0.01, "velocity": 0.1},
        "touch": {"type": "viscoelastic", "between": ["hand", "ball"], "stiffness": 900.0, "damping": 2.0},
        "gut": {"type": "string", "masses": 9, "mass": 0.001, "stiffness": 5000.0, "pluck": {"at": 2, "by": 0.002}},
    }
    device = {"mass": 0.2, "clock": "lockstep"}
    own = {"pick_" + name: one for name, one in (SOUND if sound is None else sound).items()}
    document = {"version": 1, "rate": RATE, "substeps": SUBSTEPS, "device": device, "modules": modules, "sound": own}
    return Scene.model_validate(document | differences)


def played(scene: Scene, hands: list[int], change: Any = None) -> tuple[LoopMemory, NDArray[np.float32]]:
    """The frames of a loop whose hand is at these counts, sample by sample; `change` is made before the first."""
    loop = assembled(scene)
    if change is not None:
        change(LiveScene(scene, loop))
    for number, counts in enumerate(hands):
        assert arrive(loop, frame(number, counts), 1 + number * 1_000_000) == RECEIVED
    assert loop.sound is not None
    frames = loop.sound.drain()
    assert loop.sound.lost == 0
    return loop, frames


def worked_out(scene: Scene, hands: list[int]) -> NDArray[np.float64]:
    """Returns the signal of each pick-up of SOUND in each step, without gain and filter."""
    program, rows = compile_scene(scene), []
    measured, velocity, force = np.zeros((3, 1))
    before = measured[0] = hands[0] * POSITION_SCALE
    start(program, measured)
    for counts in hands:
        target = counts * POSITION_SCALE
        for j in range(1, SUBSTEPS + 1):
            here, earlier = positions_of(program)
            ball, gut = (program.numbers[name] for name in ("ball", "gut.2"))
            way, place = here[ball] - earlier[ball], here[gut]
            measured[0] = before + (target - before) * j / SUBSTEPS
            tick(program, measured, velocity, force)
            rows.append([way * STEP_RATE, place, force[0]])
        before = target
    return np.array(rows)


def test_each_step_sounds_times_its_gain_and_through_its_highpass() -> None:
    hands = [0, 100, 300, 250, 260, 400]
    _, frames = played(scene_of(), hands)
    raw = worked_out(scene_of(), hands)
    wanted = raw * [2.0, 30.0, 0.01]
    keeps, passed, last = np.exp(-2 * np.pi * 50.0 / STEP_RATE), 0.0, 0.0
    for row in wanted:
        passed, last = keeps * (passed + row[1] - last), row[1]
        row[1] = passed
    assert np.abs(wanted).max() < KNEE
    assert np.abs(wanted).max(axis=0).min() > 1e-3
    np.testing.assert_allclose(frames, wanted, rtol=1e-6, atol=1e-8)


def test_what_is_too_loud_is_clipped_softly_and_counted() -> None:
    sound = {name: one | {"gain": 40.0 * one["gain"]} for name, one in SOUND.items()}
    quiet, loud = played(scene_of(), [0, 100, 300])[1], played(scene_of(sound), [0, 100, 300])
    unclipped = 40.0 * quiet.astype(float)
    above = np.abs(unclipped) > KNEE
    assert loud[0].record.sound.clipped == above.sum() > 0
    np.testing.assert_allclose(loud[1][~above], unclipped[~above], rtol=1e-5)
    assert np.all(np.abs(loud[1][above]) < 1.0)
    assert np.all(np.sign(loud[1][above]) == np.sign(unclipped[above]))
    order = np.argsort(np.abs(unclipped[above]))
    assert np.all(np.diff(np.abs(loud[1][above])[order]) >= 0.0)
    np.testing.assert_allclose(loud[0].record.sound.peak[:3], np.abs(unclipped).max(axis=0), rtol=1e-5)


def test_a_gain_ramps_and_a_pick_up_elsewhere_crossfades() -> None:
    hands = [0, 100, 300, 250, 260, 400]
    raw = worked_out(scene_of(), hands)
    s = np.minimum(np.arange(1, len(raw) + 1) / (4 * SUBSTEPS), 1.0)
    weight = 3 * s**2 - 2 * s**3
    _, ramped = played(scene_of(), hands, lambda live: live.set({"pick_ball": {"gain": -1.0}}, 4 / RATE))
    np.testing.assert_allclose(ramped[:, 0], raw[:, 0] * (2.0 - 3.0 * weight), rtol=1e-6, atol=1e-8)
    _, moved = played(
        scene_of(), hands, lambda live: live.set({"pick_ball": {"from": "hand", "of": "force"}}, 4 / RATE)
    )
    np.testing.assert_allclose(moved[:, 0], 2.0 * (raw[:, 0] + weight * (raw[:, 2] - raw[:, 0])), rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("sound", "sentence"),
    [
        ({"ball": SOUND["ball"]}, "sound: the names and order of its pick-ups cannot change"),
        (SOUND | {"gut": SOUND["gut"] | {"highpass": 60.0}}, "sound.pick_gut.highpass cannot change"),
    ],
)
def test_other_pick_ups_need_a_new_start(sound: dict[str, Any], sentence: str) -> None:
    live = LiveScene(scene_of(), assembled(scene_of()))
    with pytest.raises(UsageError, match=sentence):
        live.adopt(scene_of(sound), 0.02)


@pytest.mark.thorough(keep=1)
@pytest.mark.parametrize("scheme", ["semi_implicit", "midpoint", "rk4", "exact"])
def test_every_scheme_sounds(scheme: str) -> None:
    sound = {name: SOUND[name] for name in ("ball", "gut")}
    hands = [0, 100, 300, 250]
    scene = scene_of(sound, scheme=scheme)
    _, frames = played(scene, hands)
    reference = played(scene_of(sound), hands)[1]
    np.testing.assert_allclose(frames, reference, rtol=0.2, atol=0.02)
