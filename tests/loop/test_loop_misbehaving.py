"""A device that does not do as it should: what is said of it, and that nothing is claimed which it did not confirm."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from loop_rig import arrive, assembled, frame, scene_of, scripted

from firmware_protocol import schema
from firmware_protocol.frames import armed_format, frame_to_host
from hapsim.errors import DeviceError, GuardError
from hapsim.loop import endings
from hapsim.loop.endings import DEVICE_STOPPED
from hapsim.loop.guards.energy_guard import ENERGY_EXCEEDED, GIVEN, SHAKING, SWINGING
from hapsim.loop.histogram import note
from hapsim.recording.recorder import Recorder
from hapsim.running import run
from hapsim.running.outcome import failure_of, trace_of
from hapsim.scene import Scene

UNCONFIRMED = "the device did not confirm that it released its force"


def status(state: int, fault: int) -> bytes:
    return frame_to_host(armed_format(1), schema.STATUS, 0, [state | fault << 8])


# What is known of the force.


@pytest.mark.usefixtures("impatient")
@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize(
    ("clock", "by_itself"),
    [
        ("device", "time to live is over, 22 ms after the last one, or when its watchdog ends, 101 ms"),
        ("host", "when its watchdog ends, 101 ms"),
    ],
)
def test_of_a_device_that_hangs_no_zero_force_is_claimed(clock: str, by_itself: str, portable: bool) -> None:
    script = [frame(n, 5000) for n in range(5)]
    with (
        scripted(script, scene=scene_of(device={"clock": clock}), hangs=True) as (scene, _),
        pytest.raises(DeviceError, match="silent for") as caught,
    ):
        run(scene, duration=60.0, portable=portable)
    told = str(caught.value)
    assert UNCONFIRMED in told
    assert by_itself in told
    assert "power it off" in told
    assert "the force is zero" not in told
    assert caught.value.trace.report.released is False


@pytest.mark.usefixtures("impatient")
def test_a_run_that_ends_as_asked_fails_where_the_device_does_not_release() -> None:
    with (
        scripted([frame(n, 0) for n in range(10)], hangs=True) as (scene, _),
        pytest.raises(DeviceError, match=f"ended normally after 5 ticks; .*{UNCONFIRMED}") as caught,
    ):
        run(scene, duration=0.005)
    assert caught.value.trace.report.ending == "done"


@pytest.mark.usefixtures("impatient")
def test_a_device_that_reports_it_is_still_armed_has_not_released() -> None:
    with (
        scripted([frame(n, 0) for n in range(10)], says_on_disarm=schema.ARMED) as (scene, _),
        pytest.raises(DeviceError, match=UNCONFIRMED),
    ):
        run(scene, duration=0.005)


# Why a device stopped, or never began.


@pytest.mark.parametrize(
    ("clock", "quiet_ms", "held_ms", "refused", "told", "not_told"),
    [
        ("device", 90, 120, 0, "position arrived 90 ms before, the last force left 120 ms before", "held up"),
        ("device", 90, 120, 7, "the last force left 120 ms before, arrived: 7 refused frames", "held up"),
        ("device", 1, 99, 0, "position arrived 1 ms before, the last force left 99 ms before", "held up"),
        ("device", 1, 120, 0, "or its port, was held up for 120 ms. `hapsim doctor`", "arrived: "),
        ("host", 150, 99, 0, "the last usable position arrived 150 ms before", "held up"),
        ("host", 150, 149, 0, "was held up for 149 ms. `hapsim doctor`", "arrived: "),
    ],
)
def test_the_description_of_a_watchdog(
    clock: str, quiet_ms: int, held_ms: int, refused: int, told: str, not_told: str
) -> None:
    """`quiet_ms`: from the last position until the device said that it stopped; `held_ms`: from the last force, or,
    where the host is the clock, how late a tick was woken."""
    scene = scene_of(device={"clock": clock})
    loop = assembled(scene)
    for n in range(3):
        arrive(loop, frame(n, 0), 10**9 + n * 10**6)
    stopped_ns = 10**9 + (2 + quiet_ms) * 10**6
    if clock == "device":
        loop.state.sent_ns = stopped_ns - held_ms * 10**6
    else:
        loop.state.sent_ns = stopped_ns  # the force that waited left before the STATUS was read
        note(loop.record.histograms.lateness, held_ms * 10**6)
    loop.inbox.decoder.crc_errors = refused
    assert arrive(loop, status(schema.LATCHED, schema.HOST_QUIET), stopped_ns) == DEVICE_STOPPED
    trace = trace_of(scene, loop, Recorder(loop.ring, True), endings.DEVICE_STOPPED)
    failure = failure_of("test", scene, loop, trace, endings.DEVICE_STOPPED)
    assert failure is not None
    sentence = str(failure)
    assert failure.held_up == ("was held up" in told)
    assert told in sentence
    assert not_told not in sentence
    assert trace.report.released is True  # it releases before it says that it is latched


@pytest.mark.parametrize("is_own", [True, False])
@pytest.mark.parametrize("ending", [endings.SILENT, endings.DEVICE_STOPPED])
@pytest.mark.parametrize("fault", [schema.HOST_QUIET, schema.POSITION_OUT_OF_RANGE])
def test_only_this_machine_makes_its_own_mock_late(is_own: bool, ending: int, fault: int) -> None:
    scene = scene_of(device={"clock": "device"})
    loop = assembled(scene)
    loop.has_own_mock = is_own
    arrive(loop, frame(0, 0), 10**9)
    loop.state.sent_ns = 10**9
    arrive(loop, status(schema.LATCHED, fault), 10**9 + 120 * 10**6)
    trace = trace_of(scene, loop, Recorder(loop.ring, True), ending)
    failure = failure_of("test", scene, loop, trace, ending)
    assert failure is not None
    held_up = is_own and (ending == endings.SILENT or fault == schema.HOST_QUIET)
    assert failure.held_up == held_up
    assert ("This machine held up the mock, which runs in this program. `hapsim doctor`" in str(failure)) == held_up
    assert ("With `--transport paced`" in str(failure)) == held_up


@pytest.mark.parametrize(("found", "told"), [(0.25, "0.25"), (0.20049, "0.2005"), (np.nextafter(0.2, 1.0), "0.2001")])
def test_what_is_above_a_limit_is_reported_above_it(found: float, told: str) -> None:
    scene = scene_of()
    loop = assembled(scene)
    energy = loop.record.energy_guard
    energy.work = energy.given = found
    energy.swing_limit = energy.limit = 0.2

    def sentence(ending: int) -> str:
        return str(failure_of("test", scene, loop, trace_of(scene, loop, Recorder(loop.ring, True), ending), ending))

    energy.why = SWINGING
    assert f"gave the hand {told} J over these, above the limit of 0.2 J" in sentence(ENERGY_EXCEEDED)
    energy.why = GIVEN
    assert f"had given the hand {told} J more than it received, above the limit of 0.2 J;" in sentence(ENERGY_EXCEEDED)
    energy.why, energy.shakes = SHAKING, 17
    shook = "the force shook at its limit: from one side to the other 17 times in a row, the last at tick 0,"
    assert shook in sentence(ENERGY_EXCEEDED)


def test_a_status_that_is_neither_idle_nor_latched_is_reported_as_it_came() -> None:
    with (
        scripted([frame(0, 0), status(schema.ARMED, schema.NO_FAULT)]) as (scene, _),
        pytest.raises(DeviceError, match="stopped after 1 ticks: it sent a STATUS with state 1 and fault 0"),
    ):
        run(scene, duration=0.01)


def test_positions_that_are_numbered_as_old_are_no_silence() -> None:
    script = [frame(0, 0), frame(1, 0), frame(1, 0) * 3]
    with (
        scripted(script, scene=scene_of(device={"clock": "device"})) as (scene, _),
        pytest.raises(DeviceError, match="no usable position came from the device") as caught,
    ):
        run(scene, duration=60.0)
    assert "3 repeated positions" in str(caught.value)


# What a measurement makes of it.


def ringing(samples: int) -> list[bytes]:
    """Positions of a decaying swing, whatever the force: 1 mm, 15 Hz, 200 counts at its end."""
    n = np.arange(samples)
    swing = 1000.0 * np.exp(-n / (0.6 * samples)) * np.cos(2.0 * np.pi * 15.0e-3 * n)
    return [frame(i, int(counts)) for i, counts in enumerate(np.rint(swing))]


@pytest.fixture
def file_of(tmp_path: Path) -> Callable[[Scene], Path]:
    def write(scene: Scene) -> Path:
        path = tmp_path / "scene.yaml"
        path.write_text(yaml.safe_dump(scene.model_dump(mode="json", exclude_none=True)), encoding="utf-8")
        return path

    return write


@pytest.mark.thorough(keep=2)
@pytest.mark.parametrize(
    ("samples", "last", "told"),
    [
        (3, None, "went away after"),
        (3, b"", "silent for"),
        (3, status(schema.LATCHED, 77), "fault 77"),
        (400, b"", "silent for"),
        (400, status(schema.LATCHED, schema.HARDWARE), "found a fault in its own hardware"),
    ],
)
def test_a_measurement_that_fails_reports_why(
    hapsim: Callable[..., Any], file_of: Callable[[Scene], Path], last: bytes | None, told: str, samples: int
) -> None:
    for words in ((), ("--json",)):
        with scripted([*ringing(samples), last], scene=scene_of(device={"clock": "device"})) as (scene, _):
            answer = hapsim("measure", file_of(scene), *words)
        assert answer.status == 3
        assert told in answer.err
    document = answer.document
    assert (document["exit_status"], document["error"] in answer.err) == (3, True)
    assert document["predicted"]["k"] is not None
    assert document["ticks"] == samples
    assert (document["measured"] is not None) == (samples == 400)
    if samples == 400:
        assert document["measured"]["frequency_hz"] == pytest.approx(15.0, rel=1e-2)


# What a user sees of bad bytes, and how long a run lasts.


def test_garbage_and_refused_frames_are_reported(hapsim: Callable[..., Any], file_of: Callable[[Scene], Path]) -> None:
    spoilt = bytes([frame(9, 9)[0] ^ 1]) + frame(9, 9)[1:]
    script = [frame(0, 0), b"x" * 20 + frame(1, 0), spoilt + frame(2, 0), *[frame(n, 0) for n in range(3, 9)]]
    for words in ((), ("--json",)):
        with scripted(script, registers={schema.REG_REJECTED: 5}) as (scene, _):
            answer = hapsim("run", file_of(scene), "--duration", 0.006, *words)
        assert answer.status == 0, answer.err
        if not words:
            for label, count in (("refused by this host", 1), ("no frame", 20), ("refused by the device", 5)):
                assert any(label in row and str(count) in row for row in answer.out.splitlines())
    document = answer.document
    assert (document["crc_errors"], document["garbage_bytes"], document["rejected_by_device"]) == (1, 20, 5)


@pytest.mark.parametrize("step", [1, 2, 5])
def test_lost_positions_make_no_run_longer(step: int) -> None:
    with scripted([frame(n * step, 0) for n in range(60)]) as (scene, _):
        trace = run(scene, duration=0.05)
    assert trace.sample[-1] == 50 - 50 % step - (step == 1)
    assert trace.report.duration_s == pytest.approx(trace.sample[-1] / 1000.0)


# A position where no hand gets.


@pytest.mark.thorough(keep=4)
@pytest.mark.parametrize("portable", [False, True])
@pytest.mark.parametrize("clock", ["lockstep", "device", "host"])
@pytest.mark.parametrize("from_sample", [0, 20])
def test_a_position_that_leaps_ends_the_run_before_it_is_answered(clock: str, portable: bool, from_sample: int) -> None:
    far = 2_000_000_000 if clock == "host" else 500_000
    script = [frame(n, 0 if n < from_sample else far * (-1) ** n) for n in range(200)]
    with scripted(script, scene=scene_of(device={"clock": clock}), force_limit=(10.0,)) as (scene, device):
        with pytest.raises(GuardError, match="the position of channel 0 leapt at tick") as caught:
            run(scene, duration=60.0, portable=portable)
        assert not device.armed
        assert len({heard.number for heard in device.forces}) <= max(from_sample, 2)
    assert caught.value.exit_status == 4
    assert caught.value.trace.report.ending == "position leapt"
