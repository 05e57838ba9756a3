"""Gates in a running loop: what a device's input does to the force, recorded, replayed and judged."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.errors import UsageError
from hapsim.replaying.replay import Record, compare
from hapsim.running.session import Session
from hapsim.running.session_options import Excitation
from hapsim.scene import Scene
from tests import one_hand

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from changes import Ticking

ENDS = {"between": ["hand", "wall"]}
WALL = ENDS | {"type": "buffer", "stiffness": 1000.0}
HELD = {"initial": {"position": -0.005}, "hand": {"stiffness": 20000.0, "damping": 20.0, "position": -0.005}}
ALWAYS, NEVER = [0.0], [1e3]


def scene_of(modules: dict[str, Any], touch: list[float], mock: Any = None, device: Any = None, **more: Any) -> Scene:
    """A hand on these links. `touch`: when the input of the mock changes, s."""
    mock = {"inputs": {"touch": touch}} | (mock or {})
    return one_hand.scene_of(modules, device=device, mock=mock, inputs={"touch": {"bit": 0}}, **more)


def gated(link: dict[str, Any]) -> dict[str, Any]:
    return link | {"when": "touch"}


def weights(samples: int = 5) -> Any:
    s = np.arange(1, samples + 1) / samples
    return s * s * (3.0 - 2.0 * s)


@pytest.mark.parametrize("of_motor", [False, True])
def test_a_touch_fades_the_force_in_over_5_ms_and_a_release_out(of_motor: bool) -> None:
    wall, device = (WALL, {"when": "touch"}) if of_motor else (gated(WALL), {})
    trace = hapsim.run(scene_of({"stop": wall}, [0.02, 0.04], HELD, device), duration=0.06)
    share = trace.force[:, 0] / (-1000.0 * trace.position[:, 0])
    on = np.flatnonzero(trace.inputs & 1)
    assert (on[0], on[-1]) == (20, 39)
    assert not trace.force[:20].any()
    assert share[20:25] == pytest.approx(weights(), abs=1e-3)
    assert share[25:40] == pytest.approx(1.0, abs=1e-3)
    assert share[40:45] == pytest.approx(1.0 - weights(), abs=1e-3)
    assert not trace.force[45:].any()


@pytest.mark.parametrize(
    ("touch", "more"),
    [
        *((touch, more) for touch in (ALWAYS, NEVER) for more in ({}, {"substeps": 3, "precision": "single"})),
        (ALWAYS, {"device": {"law": "board"}}),
    ],
    ids=str,
)
def test_a_run_in_a_state_is_that_of_the_scene_without_gates(touch: list[float], more: dict[str, Any]) -> None:
    modules = {"stop": gated(WALL), "soft": ENDS | {"type": "spring", "stiffness": 200.0}}
    scene = scene_of(modules, touch, {"initial": {"velocity": -0.2}}, **more)
    on = frozenset({"touch"}) if touch is ALWAYS else frozenset()
    found, expected = (hapsim.run(one, duration=0.5) for one in (scene, scene.with_inputs(on)))
    assert np.array_equal(found.position_counts, expected.position_counts)
    assert np.array_equal(found.force_counts, expected.force_counts)
    assert found.force_counts.any()


@pytest.mark.parametrize(
    ("modules", "unstable"),
    [
        ({"soft": ENDS | {"type": "spring", "stiffness": 2500.0},
          "oil": gated(ENDS | {"type": "damper", "damping": 5.0})}, NEVER),
        ({"soft": ENDS | {"type": "spring", "stiffness": 500.0},
          "stop": gated(ENDS | {"type": "spring", "stiffness": 3000.0})}, ALWAYS),
    ],
    ids=["needs its damper", "is too stiff"],
)  # fmt: skip
def test_the_state_that_is_predicted_unstable_is_the_one_that_swings(modules: Any, unstable: list[float]) -> None:
    prediction = hapsim.predict(scene_of(modules, ALWAYS))
    states = {tuple(ALWAYS): prediction.judge.is_stable}
    states[tuple(NEVER)] = prediction.with_inputs_off["touch is off"].stable
    for touch in (ALWAYS, NEVER):
        scene = scene_of(modules, touch, {"initial": {"velocity": 0.05}})
        position = hapsim.run(scene, duration=2.0, unstable=True).position[:, 0]
        begun, left = np.ptp(position[:200]), np.ptp(position[-200:])
        assert states[tuple(touch)] == (left < begun)
        assert (left > begun) == (touch is unstable)
    with pytest.raises(UsageError, match="predicted unstable"):
        hapsim.run(scene_of(modules, ALWAYS), duration=1.0, unstable=False)


@pytest.mark.parametrize("correction", ["none", "poles"])
@pytest.mark.parametrize("touch", [None, NEVER], ids=["on", "off"])
def test_what_is_measured_in_a_state_is_what_is_predicted_for_it(touch: list[float] | None, correction: str) -> None:
    soft = ENDS | {"type": "viscoelastic", "stiffness": 1200.0, "damping": 4.0}
    modules = {"soft": gated(soft)}
    device: dict[str, Any] = {"correction": correction}
    if correction == "none":
        modules["always"] = soft | {"stiffness": 300.0, "damping": 1.0}
    else:
        device["stiffness"] = 300.0
    document = scene_of(modules, touch or ALWAYS, device=device).document
    if touch is None:
        del document["mock"]
    scene = Scene.model_validate(document)
    found = hapsim.measure(scene)
    (felt,) = hapsim.predict(scene.with_inputs(frozenset() if touch else frozenset({"touch"}))).felt
    assert found.k == pytest.approx(felt.k, rel=1e-4)
    assert found.b == pytest.approx(felt.b, rel=1e-3)


@pytest.mark.parametrize("of_motor", [False, True])
def test_the_energy_of_a_touch_comes_from_the_tank_which_shortens_the_fade(of_motor: bool) -> None:
    """Pressed 5 mm deep: 12.5 mJ, of which the tank has 2 mJ, and 0.2 mJ more a second."""
    wall, device = (WALL, {"when": "touch"}) if of_motor else (gated(WALL), {})
    scene = scene_of({"stop": wall}, [0.02], HELD, device | {"energy_limit": 0.002})
    sessions: list[Session] = []
    trace = hapsim.run(scene, duration=0.1, judges_energy=True, on_start=sessions.append)
    depth = 5e-3
    held = 500.0 * depth**2
    tank = sessions[0]._loop.record.tank
    assert int(tank.slowed_ticks) > 50
    assert float(tank.spent) == pytest.approx(0.002 + 0.0002 * 0.1, rel=0.02)
    assert trace.force[-1, 0] / 5.0 == pytest.approx(float(tank.spent) / held, rel=0.03)


def changed(scene: Scene, acts: dict[int, Any], duration: float, **options: Any) -> Any:
    """Runs the scene. `acts`: called with the session before ticks, by number."""
    sessions: list[Session] = []

    def before(_sample: int) -> None:
        if sessions and (act := acts.pop(int(sessions[0]._loop.state.ticks), None)):
            act(sessions[0])

    return hapsim.run(
        scene, duration=duration, between=lambda device: Ticking(device, before), on_start=sessions.append, **options
    )


def test_a_set_and_an_adopted_scene_go_on_with_the_gates() -> None:
    device = {"friction": 5.0}
    scene = scene_of({"stop": gated(WALL)}, [0.03], HELD, device)
    more = {"stop": gated(WALL | {"stiffness": 1500.0}), "soft": ENDS | {"type": "spring", "stiffness": 0.1}}
    acts = {
        10: lambda session: session.set({"stop": {"stiffness": 1200.0}}, over=0.005),
        31: lambda session: session.adopt(scene_of(more, [0.03], HELD, device), over=0.01),
    }
    trace = changed(scene, acts, 0.08)
    share = trace.force[:, 0] / -trace.position[:, 0]
    assert not acts
    assert not trace.force[:30].any()
    assert share[-1] == pytest.approx(1500.0, rel=1e-3)
    assert (np.diff(share[30:]) > -30.0).all()


@pytest.mark.parametrize("of_motor", [False, True])
def test_records_with_gates_are_replayed_to_the_bit(tmp_path: Path, of_motor: bool) -> None:
    wall, device = (WALL, {"when": "touch"}) if of_motor else (gated(WALL), {})
    swing = {"initial": {"position": -0.005, "velocity": 0.05}}
    scene = scene_of({"stop": wall}, [0.02, 0.03, 0.033, 0.05], swing, device | {"energy_limit": 0.02})
    path = tmp_path / "a.trace"
    acts = {10: lambda session: session.set({"stop": {"stiffness": 1200.0}}, over=0.03)}
    trace = changed(scene, acts, 0.08, record=path, judges_energy=True)
    found = compare(Record(path), None, None, False)
    assert trace.force.any()
    assert (found.ticks, found.changes, found.difference) == (80, 1, None)


@pytest.mark.parametrize("of_motor", [False, True])
def test_a_record_that_begins_within_a_fade_is_replayed_to_the_bit(tmp_path: Path, of_motor: bool) -> None:
    """The tank makes the fade last."""
    wall, device = (WALL, {"when": "touch"}) if of_motor else (gated(WALL), {})
    scene = scene_of({"stop": wall}, [0.02], HELD, device | {"energy_limit": 1e-4})
    path = tmp_path / "a.trace"
    with hapsim.start(scene, judges_energy=True, keep=False) as session:
        _until(session, 100)
        session.record(path)
        _until(session, int(session._loop.state.ticks) + 100)
    record = Record(path)
    found = compare(record, None, None, True)
    assert record.run.first_tick >= 100
    assert found.ticks > 50
    assert found.difference is None
    assert 0.0 < abs(found.recorded).max() < 2.0  # N, of 5


def _until(session: Session, tick: int) -> None:
    while int(session._loop.state.ticks) < tick:
        assert not session.wait(1e-3)


def test_a_motor_that_is_off_has_no_push_either() -> None:
    scene = scene_of({"stop": WALL}, NEVER, device={"when": "touch"})
    push = Excitation(0, 2.0, 20, 40, 10, True)
    trace = hapsim.run(scene, duration=0.1, excitation=push)
    assert not trace.force_counts.any()


def test_the_slew_limit_bounds_a_fade() -> None:
    scene = scene_of({"stop": gated(WALL)}, [0.02], HELD, {"slew_limit": 200.0})
    step = np.diff(hapsim.run(scene, duration=0.1).force[:, 0])
    assert step.max() == pytest.approx(0.2, rel=1e-6)
    assert np.count_nonzero(step > 0.19) > 20
