"""A scene while it runs: watched, changed, stopped; and what is refused leaves everything as it was."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from loop_rig import frame, scene_of, scripted, served

import hapsim
from hapsim.errors import DeviceError, UsageError
from hapsim.recording.recorder import Recorder
from hapsim.running import Session
from hapsim.running import session as session_module


def reaches(session: Session, done: Callable[[], bool]) -> None:
    """Waits until the loop has got so far; a run that never does is a failure."""
    for _ in range(5000):
        if done():
            return
        time.sleep(0.002)
    session.stop()
    pytest.fail("the loop never got there")


def test_a_session_runs_until_it_is_stopped_and_leaves_its_trace() -> None:
    with hapsim.start(scene_of()) as session:
        reaches(session, lambda: session.progress().elapsed_s >= 0 and session.statistics().age.total > 1000)
        with pytest.raises(UsageError, match="leave the with-block"):
            _ = session.trace
        session.stop()
        assert session.wait(10.0)
    assert session.trace.report.ending == "stopped"
    assert session.trace.sample.tolist() == list(range(session.trace.report.ticks))
    assert session.trace.statistics.age.total == session.trace.report.ticks


def test_it_ends_after_its_duration_or_when_the_block_is_left() -> None:
    with hapsim.start(scene_of()) as left, hapsim.start(scene_of(), duration=0.5) as timed:
        assert timed.wait(30.0)
    assert left.trace.report.ending == "stopped"
    assert (timed.trace.report.ending, timed.trace.report.ticks) == ("done", 500)


def test_an_exception_in_the_block_releases_the_device() -> None:
    with served(scene_of()) as (scene, mock):
        with pytest.raises(ZeroDivisionError), hapsim.start(scene):
            raise ZeroDivisionError
        assert mock.board.state == 0
        assert not mock.commands.any()


@pytest.mark.parametrize("leave", [lambda session: session.close(), lambda session: session.__exit__(None)])
def test_what_ended_a_run_is_raised_when_it_is_left_or_closed_and_only_once(leave: Callable[[Session], None]) -> None:
    with scripted([frame(0, 0), None]) as (scene, _):
        session = hapsim.start(scene)
        assert session.wait(30.0)
        with pytest.raises(DeviceError, match="went away after 1 tick"):
            leave(session)
        session.close()
    assert session.trace.report.ending == "device gone"


def test_parameters_are_set_by_the_names_of_the_scene() -> None:
    with hapsim.start(scene_of(2, mock={"noise": 1e-4})) as session:
        session.set({"touch0": {"stiffness": 500.0}, "touch1": {"stiffness": 250.0, "damping": 0.0}}, over=0.0)
        session.set({"wall": {"position": 0.001}}, over=0.01)
        taken = session._loop.program.record.parameters
        reaches(session, lambda: int(taken.taken) == int(taken.posted) and int(taken.left) == 0)
        there = int(session._loop.state.ticks)
        reaches(session, lambda: int(session._loop.state.ticks) > there + 60)
        assert session.scene.links["touch1"].stiffness == 250.0
        session.stop()
    trace = session.trace
    d = trace.position[-50:, 1] - 0.001
    np.testing.assert_allclose(trace.asked_force[-50:, 1], -250.0 * d, rtol=1e-9)
    g = np.diff(trace.position[-51:, 0]) * 1000.0
    np.testing.assert_allclose(
        trace.asked_force[-50:, 0], -500.0 * (trace.position[-50:, 0] - 0.001) - 2.0 * g, rtol=1e-9, atol=1e-12
    )


@pytest.mark.parametrize(
    ("changes", "over", "sentence"),
    [
        (
            {"tuch0": {"stiffness": 1.0}},
            0.0,
            "expected the name of a module or a pick-up; did you mean 'touch0'",
        ),
        ({"touch0": {"stifness": 1.0}}, 0.0, "found 'stifness', but of a viscoelastic stiffness and damping can"),
        ({"touch0": {"damper": "centred"}}, 0.0, "found 'damper', but of a viscoelastic"),
        ({"hand0": {"channel": 1}}, 0.0, "of a device nothing can change"),
        ({"touch0": {"stiffness": -1.0}}, 0.0, r"touch0.stiffness: found -1.0, expected a number >= 0 \(N/m\)"),
        ({"touch0": {"damping": float("nan")}}, 0.0, "expected a number"),
        ({"touch0": {"stiffness": 5.0}, "wall": {"position": "x"}}, 0.0, "wall.position: found 'x'"),
        ({"touch0": {"stiffness": 5.0}}, -1.0, "over: found -1 s"),
        ({"touch0": {"stiffness": 5.0}}, float("inf"), "over: found inf s"),
        ({"touch0": {"stiffness": 5.0}}, "x", "over: found 'x' s"),
        ({"touch0": 5.0}, 0.0, "expected the names of modules, each with what changes"),
        (5.0, 0.0, "expected the names of modules, each with what changes"),
    ],
)
def test_a_wrong_change_is_reported_and_changes_nothing(changes: Any, over: float, sentence: str) -> None:
    scene = scene_of()
    with hapsim.start(scene) as session:
        with pytest.raises(UsageError, match=sentence):
            session.set(changes, over=over)
        assert session.scene == scene
        session.stop()
    assert session.trace.report.parameter_changes == 0


def test_when_it_is_over_nothing_can_be_changed_any_more() -> None:
    with hapsim.start(scene_of(), duration=0.01) as session:
        assert session.wait(30.0)
        with pytest.raises(UsageError, match="the run is over"):
            session.set({"touch0": {"stiffness": 5.0}})


@pytest.mark.parametrize("clock", ["device", "host"])
@pytest.mark.parametrize("portable", [False, True])
def test_it_stops_within_a_wait_for_a_device_that_stays_silent(clock: str, portable: bool) -> None:
    """At 0.05 Hz a device is silent only after 400 s: a run that waits for that counts as a hang."""
    with scripted([frame(0, 0)], rate_hz=0.05) as (scene, _):
        slow = scene.model_copy(update={"rate": 0.05, "device": scene.device.model_copy(update={"clock": clock})})
        with hapsim.start(slow, portable=portable) as session:
            reaches(session, lambda: session.statistics().age.total > 0)
            session.stop()
            assert session.wait(60.0)
    assert session.trace.report.ending == "stopped"


@pytest.fixture
def readers(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The names of the threads that read a ring, each time one does; the session's own looks for rows all the time."""
    names: list[str] = []
    collect = Recorder.collect

    def collect_and_report(recorder: Recorder) -> None:
        names.append(threading.current_thread().name)
        collect(recorder)

    monkeypatch.setattr(Recorder, "collect", collect_and_report)
    monkeypatch.setattr(session_module, "_COLLECT_S", 1e-4)
    return names


class CountedWaits(threading.Event):
    """An event that counts how often a thread has waited for it."""

    def __init__(self) -> None:
        super().__init__()
        self.waits = 0

    def wait(self, timeout: float | None = None) -> bool:
        self.waits += threading.current_thread().name == "telemetry"
        return super().wait(timeout)


def test_in_virtual_time_only_the_loops_own_thread_reads_the_ring(readers: list[str]) -> None:
    """Two readers would take the same rows, now and then, and each free them for both."""
    with hapsim.start(scene_of()) as session:
        session._over = CountedWaits()
        # The loop has given up its rows often, and the other thread has had its turn as often.
        reaches(session, lambda: len(readers) > 5 and session._over.waits > 20)
        while_it_ran = readers.copy()
        session.stop()
    assert set(while_it_ran) == {"haptic loop"}
    assert session.trace.sample.tolist() == list(range(session.trace.report.ticks))


@pytest.mark.parametrize("clock", ["device", "host"])
def test_in_real_time_the_ring_is_read_during_the_loop(readers: list[str], clock: str) -> None:
    with hapsim.start(scene_of(device={"clock": clock})) as session:
        reaches(session, lambda: len(readers) > 20)
        while_it_ran = readers.copy()
        session.stop()
    assert set(while_it_ran) == {"telemetry"}
    assert session.trace.report.ticks == session.trace.sample.size


@pytest.mark.parametrize(
    ("other", "sentence"),
    [
        ({"rate": 2000.0}, "rate cannot change"),
        ({"device": {"mass": 0.3}}, "device.mass cannot change"),
        ({"mock": {"noise": 1e-6}}, "mock.noise cannot change"),
        ({"channels": 2}, r"the device has 1 channel\(s\), the scene uses 2"),
    ],
)
def test_a_scene_whose_rate_or_device_differs_is_not_adopted(other: Any, sentence: str) -> None:
    with hapsim.start(scene_of()) as session, pytest.raises(UsageError, match=sentence):
        session.adopt(scene_of(**other))
