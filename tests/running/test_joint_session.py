"""Sessions of several devices: opened, armed, changed and ended together."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hapsim
from hapsim.errors import GuardError, HapsimError, UsageError
from hapsim.loop.guards.energy_guard import is_strict
from hapsim.recording.trace import load_trace
from hapsim.replaying.replay import Record, compare
from hapsim.replaying.scene_at import scene_at
from hapsim.running.joint_session import JointSession, PortSession, record_at
from hapsim.running.saving import unsaved
from hapsim.running.session_options import Excitation
from hapsim.running.session_view import Event
from hapsim.scene import Scene, parse_scene
from tests.port_scenes import MORE, two_devices

PUSHED = {"left": {"hand": {"force": 1.0}}, "right": {"phase": 0.5, "hand": {"stiffness": 200.0, "damping": 2.0}}}


def start(scene: Scene, **options: Any) -> Any:
    """Starts a scene of several devices: a JointSession, which type checkers take for a Session."""
    return hapsim.start(scene, **options)


def test_each_device_has_a_trace_and_feels_the_other() -> None:
    with start(two_devices(mocks=PUSHED), duration=1.0) as session:
        assert isinstance(session, JointSession)
        assert session.wait(20.0)
    left, right = session.traces.values()
    assert (left.report.ending, right.report.ending) == ("done", "done")
    assert left.report.released
    assert right.report.released
    # 1 N through the spring of 2000 N/m to the hand of 200 N/m
    assert right.position[-1, 0] == pytest.approx(1.0 / 200.0, rel=0.05)
    assert left.position[-1, 0] - right.position[-1, 0] == pytest.approx(1.0 / 2000.0, rel=0.05)


def test_a_link_between_them_is_changed_at_both() -> None:
    with start(two_devices(mocks=PUSHED)) as session:
        session.set({"spring.stiffness": "1 N/mm", "mocks.right.hand.stiffness": 400.0})
        session.ports["right"].set({"spring": {"damping": 7.0}, "mock.hand": {"damping": 3.0}})
        for scene in (session.scene, session.ports["left"].scene, session.ports["right"].scene):
            assert (scene.links["spring"].stiffness, scene.links["spring"].damping) == (1000.0, 7.0)
        assert session.scene.mocks["right"].hand.stiffness == 400.0
        assert session.ports["right"].scene.mock.hand.damping == session.scene.mocks["right"].hand.damping == 3.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spring.stifness": 1.0}, "found 'stifness'"),
        ({"sprung.stiffness": 1.0}, "found 'sprung'"),
        ({"spring.stiffness": -1.0, "mocks.left.hand.force": 2.0}, "spring.stiffness: found -1"),
        ({"mocks.left.hand.mass": 2.0}, "found 'mass'"),
        ({"left.delay": 2.0}, "found 'left'"),
    ],
)
def test_a_wrong_change_changes_nothing(changes: dict[str, Any], message: str) -> None:
    with start(two_devices()) as session:
        before = session.scene
        with pytest.raises(UsageError, match=message):
            session.set(changes)
        assert session.scene == before
        assert all(one.scene == before.at_port(name) for name, one in session.ports.items())


def test_what_would_change_one_device_alone_is_refused() -> None:
    with start(two_devices()) as session:
        port: PortSession = session.ports["left"]
        calls = (lambda: port.adopt(session.scene), lambda: port.trial(1), lambda: port.lease(1.0))
        for call in calls:
            with pytest.raises(UsageError, match="cannot be done in a scene with several devices"):
                call()


def test_it_is_judged_as_a_whole() -> None:
    stiff = two_devices().changed({"spring.stiffness": 4000.0})
    with pytest.raises(UsageError, match="not armed: the scene is predicted unstable"):
        start(stiff, unstable=False)
    with start(two_devices(), unstable=False) as session:
        with pytest.raises(UsageError, match="predicted unstable"):
            session.set({"spring.stiffness": 4000.0})
        assert session.scene.links["spring"].stiffness == 2000.0


def test_guards_are_strict_while_the_whole_is_predicted_unstable() -> None:
    """From 3442 N/m on both hands shake; a hand alone, from 3895 on."""

    def are_strict(session: Any, wanted: bool) -> bool:
        guards = [one._loop.record.energy_guard for one in session.ports.values()]
        return wait_until(lambda: [is_strict(one) for one in guards] == [wanted] * 2, 10.0)

    shaken = two_devices().changed({"spring.stiffness": 3600.0})
    with start(shaken, unstable=True, judges_energy=True) as session:
        assert are_strict(session, True)
        session.set({"spring.stiffness": 2000.0})
        assert are_strict(session, False)
        session.set({"spring.stiffness": 3600.0})
        assert are_strict(session, True)
    with start(two_devices(), unstable=True, judges_energy=True) as session:
        assert are_strict(session, False)


def wait_until(is_true: Callable[[], bool], most_s: float) -> bool:
    """Returns whether it becomes true, for good, within that time."""
    end = time.monotonic() + most_s
    while not (found := is_true()) and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(0.1)
    return found and is_true()


def test_a_guard_at_one_device_ends_both_and_is_named() -> None:
    limits = {
        name: {"clock": "lockstep", "mass": 0.2, "friction": 1.0, "energy_limit": limit}
        for name, limit in (("left", 1e-3), ("right", 10.0))
    }
    shaken = two_devices(devices=limits, mocks=PUSHED).changed({"spring.stiffness": 5000.0, "right.force_limit": 1e6})
    with (
        pytest.raises(GuardError, match=r"left \(mock in memory\): ") as caught,
        start(shaken, duration=5.0, unstable=True) as session,
    ):
        session.wait(20.0)
    assert "right (" not in str(caught.value)
    left, right = session.traces.values()
    assert right.report.ending == "another port ended"
    assert left.report.released
    assert right.report.released
    assert right.report.ticks < 5000


def test_a_device_that_does_not_confirm_its_release_is_named_behind_the_one_that_failed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("hapsim.running.session.disarm", lambda *_: False)
    devices = {name: {"clock": "lockstep", "mass": 0.2, "friction": 1.0} for name in ("left", "right")}
    devices["left"]["travel"] = [-0.05, 0.05]
    with (
        pytest.raises(
            HapsimError, match=r"^left .*\. And right \(mock in memory\): another device failed after"
        ) as caught,
        start(two_devices(devices=devices, mocks={"left": {"hand": {"force": 5.0}}}), duration=5.0) as session,
    ):
        session.wait(20.0)
    assert "normally" not in str(caught.value)


def test_a_device_that_cannot_be_opened_is_named_and_the_others_are_closed(tmp_path: Path) -> None:
    absent = two_devices().changed(
        {"right.port": str(tmp_path / "absent"), "right.clock": "device"} | {"left.clock": "device"}
    )
    with pytest.raises(HapsimError, match=r"^right: .*absent"):
        start(absent)
    assert hapsim.sessions() == []


def test_records_are_one_for_each_device_and_replay_to_the_bit(tmp_path: Path) -> None:
    file = tmp_path / "touch.trace"
    with start(two_devices(mocks=PUSHED), duration=0.3, record=file, keep=False) as session:
        session.wait(20.0)
        session.mark("here")
    for name in ("left", "right"):
        path = record_at(file, name)
        assert path.name == f"touch.{name}.trace"
        assert compare(Record(path), None, None, with_curves=False).difference is None


def test_events_and_warnings_name_their_device_and_one_device_is_excited() -> None:
    events, warnings = list[Event](), list[str]()
    push = Excitation(channel=0, force=2.0, ticks=20, every=10**6, start=10, first=False)
    heard: Any = {"on_event": events.append, "on_warning": warnings.append}
    with start(two_devices(), duration=0.2, excitation={"left": push}, **heard) as session:
        warn = session.ports["left"]._options.on_warning
        assert warn is not None
        warn("its motor is unknown")
        session.mark("here")
        session.wait(20.0)
    assert [event.device for event in events if event.kind == "marker"] == ["left", "right"]
    assert warnings == ["left: its motor is unknown"]
    left, right = session.traces.values()
    assert np.abs(left.position).max() > np.abs(right.position[:30]).max()
    with pytest.raises(UsageError, match=r"expected \{device: excitation\}"):
        start(two_devices(), excitation=push)


def test_masses_move_with_the_leader_and_its_sound_is_written(tmp_path: Path) -> None:
    scene = parse_scene(MORE + "mocks:\n  left: {initial: {velocity: [0, 0.1]}}\n")
    with start(scene, duration=0.2, sound_file=tmp_path / "ear.wav") as session:
        session.wait(20.0)
        state = session.ports["right"].state()
        assert session.ports["left"].state().modules["ball"] == pytest.approx(state.modules["ball"], abs=2e-4)
        assert session.ports["right"].sound_peaks["ear"] > 0.0
    assert (tmp_path / "ear.wav").stat().st_size > 4 * 100


def test_python_has_start_for_them_alone() -> None:
    with pytest.raises(UsageError, match=r"use hapsim\.start, whose session has `traces`"):
        hapsim.run(two_devices())
    with pytest.raises(UsageError, match="found a loop in Python for several devices"):
        start(two_devices(), portable=True)


def test_live_values_are_saved_in_the_file(tmp_path: Path) -> None:
    path = tmp_path / "two.yaml"
    path.write_text("# mine\n" + two_devices(mocks=PUSHED).to_yaml(), encoding="utf-8")
    with start(hapsim.load_scene(path)) as session:
        session.set({"spring.stiffness": 1234.0, "mocks.left.hand.force": 0.5})
        assert session.ports["left"].save() == path
    again = hapsim.load_scene(path)
    assert (again.links["spring"].stiffness, again.mocks["left"].hand.force) == (1234.0, 0.5)  # type: ignore[attr-defined]
    assert path.read_text(encoding="utf-8").startswith("# mine\n")


def test_a_record_of_one_device_gives_the_file_of_all_with_its_values(tmp_path: Path) -> None:
    path = tmp_path / "three.yaml"
    text = "# mine\n" + MORE + "mocks:\n  left: {hand: {force: 0.1}}\n  right: {hand: {stiffness: 33}}\n"
    path.write_text(text, encoding="utf-8")
    with start(hapsim.load_scene(path), record=tmp_path / "x.trace") as session:
        session.set({"touch.stiffness": 250.0, "own.damping": 2.0})
        assert unsaved(session.ports["left"].scene) == ["own.damping", "touch.stiffness"]
        assert unsaved(session.ports["right"].scene) == ["touch.stiffness"]
        changed_s = session.progress()["left"].elapsed_s
        while session.progress()["left"].elapsed_s < changed_s + 1.0:
            session.wait(0.01)
    at_end = load_trace(tmp_path / "x.left.trace").time_s[-1]
    found = scene_at(tmp_path / "x.left.trace", float(at_end))
    assert found.text == text.replace("stiffness: 200", "stiffness: 250").replace(
        "stiffness: 100, damping: 1", "stiffness: 100, damping: 2"
    )
