"""A device that is lost is waited for, and the scene goes on as it is by then; what a guard stopped stays stopped.

The port is a symbolic link, as udev's are, that leads to one pseudo-terminal after the other.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from loop_rig import frame, on_port, scene_of, scripted

from firmware_protocol import schema
from firmware_protocol.frames import armed_format, frame_to_host
from hapsim.device.connection import describe
from hapsim.device.mock.assemble_mock import assemble_mock
from hapsim.device.mock.terminal import serving
from hapsim.errors import DeviceError, GuardError
from hapsim.recording.trace import load_trace
from hapsim.running import Session, outcome, reconnecting
from hapsim.running import session as session_module
from hapsim.running.reconnecting import LOST, Lifetime, RunObserver, keep_running, record_of
from hapsim.scene import Scene

SOFTER = {"touch0": {"stiffness": 500.0}}


class Bench:
    """A mock that can be plugged in behind one name, and taken away."""

    def __init__(self, link: Path) -> None:
        self.link = link
        self.told: list[str] = []
        self.sentences: list[str] = []
        self.sessions: list[Session] = []
        self.waited = 0
        self._plugged = contextlib.ExitStack()

    def plug(self, scene: Scene) -> Any:
        return self.plug_in(assemble_mock(scene))

    def plug_in(self, mock: Any) -> Any:
        self.link.unlink(missing_ok=True)
        self.link.symlink_to(self._plugged.enter_context(serving(mock)))
        return mock

    def unplug(self) -> None:
        self.link.unlink(missing_ok=True)
        self._plugged.close()

    def stop(self) -> None:
        self.sessions[-1].stop()

    def stop_in_time(self) -> None:
        """Once it has exchanged something."""
        while self.sessions[-1].progress().ticks < 5 and not self.sessions[-1].wait(1e-3):
            pass
        self.stop()

    def keep(
        self, scene: Scene, *on_start: Callable[[], None], on_waiting: Callable[[], object] = lambda: None, **how: Any
    ) -> Lifetime:
        """`on_start`: at each arming the next; `on_waiting`: at the third glance of each waiting."""

        def started(session: Session) -> None:
            self.sessions.append(session)
            self.waited = 0
            on_start[len(self.sessions) - 1]()

        def waiting() -> None:
            self.waited += 1
            if self.waited == 3:
                on_waiting()

        def report(event: str, sentence: str) -> None:
            self.told.append(event)
            self.sentences.append(sentence)

        def begun(stop: Callable[[], None]) -> None:
            self.stop_run = stop

        def paused(go_on: Callable[[], None]) -> None:
            self.go_on = go_on

        observer = RunObserver(begun, started=started, waiting=waiting, paused=paused, report=report)
        return keep_running(scene, observer, **{"reconnect": True} | how)


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path / "usb-device")
    yield made
    made.unplug()


@pytest.fixture(autouse=True)
def _short_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(reconnecting, "_PAUSES_S", (0.0,))
    monkeypatch.setattr(reconnecting, "_POLL_S", 1e-3)


@pytest.fixture
def scene(bench: Bench) -> Scene:
    return on_port(scene_of(), str(bench.link))


def test_after_an_unplug_the_scene_goes_on_as_it_is_now(scene: Scene, bench: Bench, tmp_path: Path) -> None:
    mocks = [bench.plug(scene)]

    def change_and_unplug() -> None:
        bench.sessions[0].set(SOFTER)
        bench.unplug()

    record = tmp_path / "touch.npz"
    record_of(record, 1).write_text("of another day", encoding="utf-8")
    lifetime = bench.keep(
        scene, change_and_unplug, bench.stop_in_time, on_waiting=lambda: mocks.append(bench.plug(scene)), record=record
    )
    assert (lifetime.failure, lifetime.report.ending, lifetime.reconnections) == (None, "stopped", 1)
    assert bench.told == ["lost", "reconnected"]
    assert bench.sentences[0].startswith(f"{bench.link}: the device went away after ")
    assert bench.sentences[0].endswith(f". Waiting for {bench.link} to answer again")
    assert bench.sessions[1].scene.links["touch0"].stiffness == 500.0  # type: ignore[attr-defined]
    assert mocks[1].board.state == schema.IDLE
    traces = [load_trace(file) for file in lifetime.records]
    assert lifetime.records == (record, record_of(record, 2))
    assert record_of(record, 1).read_text(encoding="utf-8") == "of another day"
    assert lifetime.report.ticks == sum(trace.report.ticks for trace in traces)
    assert lifetime.report.age_samples.count == sum(trace.report.age_samples.count for trace in traces)
    assert [trace.sample[0] for trace in traces] == [0, 0]


def test_a_port_that_does_not_answer_is_tried_again(
    scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A board that boots, a ModemManager that looks at it first: told once, however often it fails."""
    bench.plug(scene)
    tries = []

    def answers_at_last(connection: Any) -> Any:
        tries.append(connection)
        if 2 <= len(tries) <= 4:
            raise DeviceError("no answer")
        return describe(connection)

    monkeypatch.setattr(session_module, "describe", answers_at_last)

    lifetime = bench.keep(scene, bench.unplug, bench.stop, on_waiting=lambda: bench.plug(scene))
    assert (lifetime.failure, lifetime.reconnections, len(tries)) == (None, 1, 5)
    assert bench.told == ["lost", "waiting", "reconnected"]


def test_another_device_in_its_place_is_not_armed(scene: Scene, bench: Bench) -> None:
    bench.plug(scene)
    other = scene_of(rate=500.0)
    others: list[Any] = []
    lifetime = bench.keep(scene, bench.unplug, on_waiting=lambda: others.append(bench.plug(other)))
    assert "the device samples at 500 Hz, the scene says 1000 Hz" in str(lifetime.failure)
    assert (lifetime.failure.exit_status, lifetime.reconnections) == (2, 0)
    assert not lifetime.interruptions[0].came_back
    assert others[0].board.state == schema.IDLE


@pytest.mark.parametrize("origin", [0.0, "here"])
def test_a_device_that_restarted_is_not_armed_with_an_origin_that_it_has_lost(bench: Bench, origin: Any) -> None:
    scene = on_port(scene_of(device={"travel": [-0.05, 0.05], "origin": origin}), str(bench.link))
    others: list[Any] = []
    bench.plug(scene)
    lifetime = bench.keep(scene, bench.unplug, bench.stop, on_waiting=lambda: others.append(bench.plug(scene)))
    if origin == "here":
        assert (lifetime.failure, lifetime.reconnections) == (None, 1)
        assert bench.sentences[-1].endswith("The device restarted: its position 0 is where it powered up or homed")
        return
    assert (lifetime.failure.exit_status, len(bench.sessions)) == (3, 1)
    assert "the device restarted" in str(lifetime.failure)
    assert others[0].board.state == schema.IDLE


def test_behind_a_cable_alone_a_device_keeps_its_zero(bench: Bench) -> None:
    """The same board, plugged in again: it counts the forces of before."""
    scene = on_port(scene_of(device={"travel": [-0.05, 0.05], "origin": 0.0}), str(bench.link))
    mock = bench.plug(scene)

    def unplug_once_it_has_forces() -> None:
        while bench.sessions[0].progress().ticks < 5 and not bench.sessions[0].wait(1e-3):
            pass
        bench.unplug()

    lifetime = bench.keep(scene, unplug_once_it_has_forces, bench.stop, on_waiting=lambda: bench.plug_in(mock))
    assert (lifetime.failure, lifetime.reconnections) == (None, 1)
    assert bench.sentences[-1].endswith("the scene continues as it is now")


def test_what_a_guard_stopped_is_not_begun_again(bench: Bench) -> None:
    scene = on_port(scene_of(), str(bench.link))
    endless = {"touch0": scene.modules["touch0"].model_copy(update={"damping": 1e308})}  # a file cannot have it
    scene = scene.model_copy(update={"modules": {**scene.modules, **endless}})
    bench.plug(scene)
    lifetime = bench.keep(scene, lambda: None)
    assert isinstance(lifetime.failure, GuardError)
    assert (bench.told, len(bench.sessions)) == ([], 1)


def test_without_being_asked_for_nothing_is_waited_for(scene: Scene, bench: Bench) -> None:
    bench.plug(scene)
    lifetime = bench.keep(scene, bench.unplug, reconnect=False)
    assert (lifetime.failure.exit_status, bench.told) == (3, [])


@pytest.mark.parametrize(("held_up", "can_go_on"), [("slow machine", True), ("slow machine", False), ("", True)])
def test_a_run_that_this_machine_held_up_goes_on_when_somebody_asks(
    scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch, held_up: str, can_go_on: bool
) -> None:
    monkeypatch.setattr(outcome, "_slowness", lambda *_: held_up)
    bench.plug(scene)

    def plug_anew() -> None:
        bench.unplug()
        bench.plug(scene)

    asked = list[int]()
    how = {"reconnect": False, "can_go_on": can_go_on, "on_waiting": lambda: asked.append(1) or bench.go_on()}
    lifetime = bench.keep(scene, plug_anew, bench.stop, **how)
    if held_up and can_go_on:
        assert asked == [1]
        assert (lifetime.failure, lifetime.reconnections, bench.told) == (None, 1, ["paused", "reconnected"])
        assert bench.sentences[0].endswith("`Go on` of the page continues the run, Ctrl-C ends it")
    else:
        assert (lifetime.failure.exit_status, bench.told) == (3, [])


def test_a_mock_that_went_away_is_begun_again_where_its_zero_is_the_same(bench: Bench) -> None:
    """The hand leaves the range of its counts after 0.2 s."""
    device = {"friction": 0.0, "mass": 1000.0, "origin": 0.0, "travel": [-0.05, 0.05]}
    mock = {"quantum": 0.1 * 0.2 / 2.0**31, "initial": {"velocity": 0.1}}
    scene = scene_of(stiffness=1.0, damping=0.0, device=device, mock=mock)
    lifetime = bench.keep(scene, lambda: None, *[bench.stop] * 50, transport="paced")
    assert (lifetime.failure, lifetime.report.ending) == (None, "stopped")
    assert lifetime.reconnections >= 1
    assert bench.sentences[0].endswith(". Waiting for the mock to answer again")
    assert bench.sentences[-1].endswith("the scene continues as it is now")


STOPS: dict[str, Callable[[Bench], object]] = {
    "SIGINT": lambda _: os.kill(os.getpid(), signal.SIGINT),
    "SIGTERM": lambda _: os.kill(os.getpid(), signal.SIGTERM),
    "SIGHUP": lambda _: os.kill(os.getpid(), signal.SIGHUP),
    "a client, in another thread": lambda bench: bench.stop_run(),
}


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("during", ["the waiting", "the next handshake", "the wait to go on"])
@pytest.mark.parametrize("stop", STOPS)
def test_a_stop_ends_a_run_and_the_device_that_is_back_is_not_armed(
    scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch, stop: str, during: str
) -> None:
    mocks, how = [bench.plug(scene)], {}

    def stops_and_describes(connection: Any) -> Any:
        STOPS[stop](bench)
        return describe(connection)

    def unplug() -> None:
        bench.unplug()
        if during == "the next handshake":
            monkeypatch.setattr(session_module, "describe", stops_and_describes)

    def waiting() -> None:
        mocks.append(bench.plug(scene))
        if during != "the next handshake":
            STOPS[stop](bench)

    if during == "the wait to go on":
        monkeypatch.setattr(outcome, "_slowness", lambda *_: "slow machine")
        how = {"reconnect": False, "can_go_on": True}
    lifetime = bench.keep(scene, unplug, on_waiting=waiting, **how)
    assert (lifetime.failure, lifetime.report.ending, lifetime.reconnections) == (None, "stopped", 0)
    assert (len(bench.sessions), mocks[1].board.state) == (1, schema.IDLE)


def test_its_time_goes_on_during_the_wait(scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fake clock advances by a second per reading, and the duration counts the wait."""
    bench.plug(scene)
    seconds = itertools.count(0.0)
    clock = SimpleNamespace(monotonic=lambda: next(seconds), sleep=lambda _: None)
    monkeypatch.setattr(reconnecting, "time", clock)
    lifetime = bench.keep(scene, bench.unplug, duration=1000.0)
    assert isinstance(lifetime.failure, DeviceError)
    assert "was lost and did not return within the duration of 1000 s" in str(lifetime.failure)
    assert (lifetime.report.ending in LOST, lifetime.report.released, lifetime.reconnections) == (True, False, 0)
    assert 990.0 < lifetime.interruptions[0].waited_s + lifetime.report.duration_s < 1010.0


def test_the_time_of_every_wait_counts(scene: Scene, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two waits of 600 s, each shorter than the 1000 s: the device that is back after the second is not armed."""
    bench.plug(scene)
    now = [0.0]
    monkeypatch.setattr(reconnecting, "time", SimpleNamespace(monotonic=lambda: now[0], sleep=lambda _: None))

    def back_later() -> None:
        bench.plug(scene)
        now[0] += 600.0

    lifetime = bench.keep(scene, bench.unplug, bench.unplug, on_waiting=back_later, duration=1000.0)
    assert "did not return within the duration of 1000 s" in str(lifetime.failure)
    assert (len(bench.sessions), lifetime.reconnections) == (2, 1)


def test_a_device_that_stopped_by_itself_is_armed_anew() -> None:
    stopped = frame_to_host(armed_format(1), schema.STATUS, 1, [schema.LATCHED | 99 << 8])
    sessions: list[Session] = []

    def started(session: Session) -> None:
        sessions.append(session)
        if len(sessions) == 2:
            session.stop()

    with scripted([frame(0, 0) + stopped]) as (scene, device):
        lifetime = keep_running(scene, RunObserver(started=started), reconnect=True)
        assert len(device.arms) == 2
    assert (lifetime.failure, lifetime.reconnections) == (None, 1)
    assert "the device stopped after" in lifetime.interruptions[0].why
