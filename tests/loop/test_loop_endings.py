"""Every way out of a run leaves the device disarmed and its force at zero."""

from __future__ import annotations

import json
import os
import signal
import threading
import time
from pathlib import Path
from typing import Any

import pytest
import yaml
from loop_rig import CLOCKS, assembled, frame, scene_of, scripted, served

import hapsim
from firmware_protocol import schema
from firmware_protocol.frames import armed_format, frame_to_host
from hapsim.compiling import entry
from hapsim.errors import DeviceError
from hapsim.loop.counts import Progress
from hapsim.loop.endings import DONE, RING_FULL, RUNNING, STOPPED, ending_before_exchange
from hapsim.loop.ring import UNSENT
from hapsim.recording.trace import load_trace
from hapsim.running import run
from hapsim.running import session as session_module


def require_released(mock: Any, state: int = schema.IDLE) -> None:
    assert mock.board.state == state
    assert not mock.commands.any()


@pytest.mark.parametrize("clock", CLOCKS)
def test_at_the_end_of_the_duration_the_device_is_disarmed(clock: str) -> None:
    with served(scene_of(2, device={"clock": clock})) as (scene, mock):
        trace = run(scene, duration=0.1)
        require_released(mock)
    assert trace.report.ending == "done"
    assert trace.report.ticks >= 100 or (trace.report.duration_s > 0.1 and clock != "lockstep")


@pytest.mark.parametrize("portable", [False, True])
def test_a_stop_between_two_ticks_ends_a_run_by_the_hosts_clock_before_the_next(portable: bool) -> None:
    """A tick lasts ten seconds: the run does not wait for the next, and no exchange is made early in its place."""
    scene = scene_of(rate=0.1, device={"clock": "host"})
    with hapsim.start(scene, portable=portable) as session:
        while session.statistics().age.total == 0:
            session.wait(0.01)
        session.wait(0.05)  # by now it sleeps
        session.stop()
        assert session.wait(5.0)
    trace = session.trace
    assert trace.report.ending == "stopped"
    assert trace.flags.tolist() == [UNSENT]
    assert trace.statistics.lateness.total == 0


@entry
def ending_in_compiled_code(loop):
    """`ending_before_exchange` as the compiled loops have it."""
    return ending_before_exchange(loop)


@pytest.mark.parametrize(
    ("stop", "ticks", "unread", "waits", "ending"),
    [
        (0, -1, 0, 1, RUNNING),
        (0, 8, 0, 1, RUNNING),
        (0, 7, 0, 1, DONE),
        (1, 7, 0, 1, STOPPED),
        (0, -1, 65536, 1, RING_FULL),
        (0, -1, 65536, 0, RUNNING),
    ],
)
def test_a_loop_ends_alike_in_compiled_code_and_in_python(
    stop: int, ticks: int, unread: int, waits: int, ending: int
) -> None:
    loop = assembled(scene_of())
    loop.control.stop, loop.control.samples, loop.state.ticks = stop, ticks, 7
    loop.control.lasts_ns = 10**9
    loop.record.ring.head, loop.record.ring.waits = unread, waits
    assert ending_in_compiled_code(loop.record) == ending_before_exchange(loop.record) == ending


@pytest.mark.parametrize("clock", CLOCKS)
def test_an_exception_of_a_progress_callback_disarms_and_comes_through(clock: str) -> None:
    class OfTheirOwnError(Exception):
        pass

    def watch(progress: Progress) -> None:
        if progress.phase == "running":
            raise OfTheirOwnError

    with served(scene_of(device={"clock": clock})) as (scene, mock):
        with pytest.raises(OfTheirOwnError):
            run(scene, duration=None, keep=False, on_progress=watch)
        require_released(mock)


@pytest.mark.parametrize("clock", CLOCKS)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_that_means_stop_ends_the_run_in_good_order(clock: str, number: signal.Signals) -> None:
    sent = threading.Event()

    def watch(progress: Progress) -> None:
        if progress.phase == "running" and not sent.is_set():
            sent.set()
            os.kill(os.getpid(), number)

    before = signal.getsignal(number)
    with served(scene_of(device={"clock": clock})) as (scene, mock):
        trace = run(scene, duration=None, keep=False, on_progress=watch, stop_on_signals=True)
        require_released(mock)
    assert trace.report.ending == "stopped"
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_the_command_ends_with_status_0_on_a_signal_with_its_record(
    start_hapsim: Any, tmp_path: Path, number: signal.Signals
) -> None:
    record, file = tmp_path / "trace.npz", tmp_path / "scene.yaml"
    with served(scene_of(device={"clock": "device"})) as (scene, mock):
        file.write_text(yaml.safe_dump(scene.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
        host = start_hapsim("run", file, "--record", record, "--json")
        while mock.board.state != schema.ARMED and host.poll() is None:
            time.sleep(0.01)
        os.kill(host.pid, number)
        assert host.wait() == 0, host.err
        require_released(mock)
    report = json.loads(host.out)
    assert report["ending"] == "stopped"
    assert load_trace(record).report.ticks == report["ticks"]


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_signal_during_arming_ends_the_run_in_good_order(monkeypatch: pytest.MonkeyPatch, clock: str) -> None:
    """Neither too early to be a run's end, nor too late to be heard."""
    armed = session_module.arm

    def arm_and_interrupt(*arguments: Any) -> None:
        armed(*arguments)
        os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(session_module, "arm", arm_and_interrupt)
    with served(scene_of(device={"clock": clock})) as (scene, mock):
        trace = run(scene, duration=5.0, stop_on_signals=True)
        require_released(mock)
    assert trace.report.ending == "stopped"
    assert trace.report.ticks < 1000


@pytest.mark.parametrize("clock", CLOCKS)
def test_a_device_that_stops_by_itself_ends_the_run_and_reports_why(clock: str) -> None:
    """2^31 counts of a picometre are two millimetres."""
    scene = scene_of(
        stiffness=0.0, damping=0.0, device={"clock": clock}, mock={"quantum": 1e-12, "initial": {"velocity": 0.1}}
    )
    with served(scene) as (scene, mock):
        with pytest.raises(
            DeviceError,
            match=r"left the range of its counts\. The .* at its end on channel .*force is zero: the device confirmed",
        ) as caught:
            run(scene, duration=5.0)
        require_released(mock)
    assert caught.value.exit_status == 3
    assert caught.value.trace.report.ending == "device stopped"
    assert caught.value.trace.report.ticks >= 1


@pytest.mark.parametrize("clock", ["device", "host"])
def test_a_silent_device_ends_the_run_with_zero_force(clock: str) -> None:
    scene = scene_of(device={"clock": clock})
    with scripted([frame(n, 0) for n in range(5)], scene=scene) as (scene, device):
        with pytest.raises(DeviceError, match=r"silent for 250 ms after 5 ticks; the force is zero") as caught:
            run(scene, duration=60.0)
        assert not device.armed
        assert device.disarmed >= 1
    assert caught.value.trace.sample.tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("clock", CLOCKS)
def test_a_port_that_hangs_up_ends_the_run(clock: str, portable: bool) -> None:
    script = [*[frame(n, n) for n in range(4)], None]
    with (
        scripted(script, scene=scene_of(device={"clock": clock})) as (scene, _),
        pytest.raises(DeviceError, match=r"went away after \d ticks \(unplugged, or its port closed\)") as caught,
    ):
        run(scene, duration=60.0, portable=portable)
    trace = caught.value.trace
    # Where the host is the clock it may ask twice before it reads, and the last answers go with the port.
    assert trace.sample.tolist() == [0, 1, 2, 3][: trace.report.ticks]
    assert (trace.report.ticks == 4 or clock == "host", trace.report.ending) == (True, "device gone")


@pytest.mark.parametrize("fault", [*sorted(schema.FAULTS), 77])
def test_a_fault_that_the_device_reports_is_reported_in_words(fault: int) -> None:
    status = frame_to_host(armed_format(1), schema.STATUS, 3, [schema.LATCHED | fault << 8])
    told = schema.FAULTS.get(fault, "fault 77, which version 1 of the protocol does not name")
    with (
        scripted([frame(0, 0), frame(1, 0) + status]) as (scene, _),
        pytest.raises(DeviceError, match=f"stopped after 2 ticks: {told}") as caught,
    ):
        run(scene, duration=1.0)
    assert caught.value.trace is not None


def test_a_host_that_died_in_virtual_time_does_not_lock_the_next_one_out(start_hapsim: Any) -> None:
    """Virtual time has no watchdog: the mock stays armed, and reads only its armed format."""
    dies = (
        "hapsim.run(parse_scene(sys.argv[1]), on_progress=lambda p: os.kill(os.getpid(), 9) "
        "if p.phase == 'running' else None)"
    )
    with served(scene_of()) as (scene, mock):
        text = yaml.safe_dump(scene.model_dump(mode="json", exclude_none=True))
        assert start_hapsim(text, program=dies).wait() == -9
        assert mock.board.state == schema.ARMED
        trace = run(scene, duration=0.05)
        require_released(mock)
    assert trace.sample.tolist() == list(range(50))
