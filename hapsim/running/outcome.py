"""The outcome of a run: its report, and the error of a run that failed."""

from __future__ import annotations

import math
from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.device.connection import fault_text
from hapsim.errors import DeviceError, GuardError, RecordError, RunError
from hapsim.loop import endings
from hapsim.loop.buffers import force_now
from hapsim.loop.counts import Progress, words_at
from hapsim.loop.exchange import HOST_CLOCK
from hapsim.loop.guards import guard_that_ended, in_words
from hapsim.loop.guards.energy_guard import STEADINESS_ADVICE
from hapsim.loop.guards.frozen_sensor import frozen_sentence
from hapsim.loop.guards.leap import at_end_of_counts
from hapsim.loop.histogram import histogram_of
from hapsim.loop.hooks import EndedRun
from hapsim.loop.ring import commands_in, lines_in, sensed_in, words_in
from hapsim.number_format import duration, plural
from hapsim.prediction import unlikely
from hapsim.prediction.timing import host_silence
from hapsim.recording.background_file import BackgroundFile
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Report, Statistics, Trace, columns_of
from hapsim.running.assemble_loop import LoopMemory
from hapsim.scene import Scene

_FAR_BEYOND = 2.0  # times the force limit: a hand that presses that much is not held
_PACED_ADVICE = (
    '. With `--transport paced` (in Python `transport="paced"`) the mock waits, and a late sample ends no run'
)
_TELLING_S = 1.0  # a force withheld for this time at the end of a run makes it fail


def trace_of(scene: Scene, loop: LoopMemory, recorder: Recorder, ending: int) -> Trace:
    """Returns the trace of a loop that has ended."""
    rows, io, used = recorder.rows(), loop.record.io, slice(loop.wire.channels)
    report, statistics = report_of(scene, loop, in_words(ending))
    return Trace(
        scene.rate,
        **columns_of(rows),
        **words_in(rows),
        position_scale=io.position_scale[used].copy(),
        force_scale=io.force_scale[used].copy(),
        statistics=statistics,
        report=report,
        sensed=sensed_in(rows, lambda name: io[f"{name}_scale"][used]),
        command=commands_in(rows, io.position_scale[used]),
        line_counts=lines_in(rows),
    )


def statistics_of(loop: LoopMemory) -> Statistics:
    """Returns the histograms of a loop now, in s and in samples."""
    counted = loop.record.histograms
    return Statistics(
        lateness=histogram_of(counted.lateness, 1e-9),
        exchange=histogram_of(counted.exchange, 1e-9),
        age=histogram_of(counted.age),
    )


def progress_of(loop: LoopMemory) -> Progress:
    """Returns the progress of a loop now."""
    state, io, used = loop.state, loop.record.io, slice(loop.wire.channels)
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    sensor, period_s = loop.record.frozen_sensor, 1e-9 * int(loop.control.period_ns)
    now_s = sensor.still * sensor.frozen * period_s
    return Progress(
        "running",
        elapsed_s=elapsed,
        rate_hz=(int(state.ticks) - 1) / elapsed if elapsed > 0 else 0.0,
        force=tuple(force_now(io, loop.wire.channels).tolist()),
        position=tuple(io.measured[used].tolist()),
        age_samples=int(state.age),
        words=loop.rendered_scene.word_values(int(io.inputs), int(io.outputs)),
        frozen=frozen_sentence(loop.rendered_scene, int(np.argmax(now_s)), float(now_s.max())),
        **counters_of(loop),
    )


def counters_of(loop: LoopMemory) -> dict[str, Any]:
    """Returns the counts and estimates of a loop, by the names of `Counts`, without `frozen`."""
    decoder, record, wire = loop.inbox.decoder, loop.record, loop.wire
    counts = {
        name: int(attrgetter(f"state.{name}" if at == "state" else at)(record)) for name, at in words_at("at").items()
    }
    pending = int(decoder.seen)  # bytes since the last delimiter: garbage if longer than a frame
    is_frame = pending <= schema.frame_bytes(wire.channels, to_device=False, parts=wire.parts)
    counts |= {
        "parameter_changes": loop.changes,
        "crc_errors": int(decoder.crc_errors + decoder.length_errors + decoder.form_errors),
        "garbage_bytes": int(decoder.garbage_bytes) + (0 if is_frame else pending),
        "slowed_ticks": -(-int(record.tank.slowed_ticks) // int(record.slot.substeps)),
    }
    masses = {} if loop.correction is None else loop.correction.masses(loop.wire.channels)
    sound = {} if loop.sound_output is None else loop.sound_output.counts()
    sensor = "" if loop.sensor_check is None else loop.sensor_check.sentence(loop.rendered_scene)
    sentences = {"wrong_sensor": sensor, "unknown_motor": loop.unknown_motor, "armed_inside": loop.armed_inside()}
    return counts | masses | sound | sentences


def report_of(scene: Scene, loop: LoopMemory, ending: str) -> tuple[Report, Statistics]:
    """Returns the report and the histograms of a loop, during the run or afterwards."""
    state, statistics, sensor = loop.state, statistics_of(loop), loop.record.frozen_sensor
    samples = max(int(state.ticks) - 1, 0)
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    if loop.is_virtual:
        elapsed = (samples + int(state.lost_frames)) / scene.rate
    report = Report(
        ending=ending,
        duration_s=elapsed,
        rate_hz=samples / elapsed if elapsed > 0 else 0.0,
        nominal_rate_hz=scene.rate,
        frozen=frozen_sentence(loop.rendered_scene, int(sensor.channel), float(sensor.longest / scene.rate)),
        lateness_s=statistics.lateness.spread(),
        exchange_s=statistics.exchange.spread(),
        age_samples=statistics.age.spread(),
        virtual_time=loop.is_virtual,
        motion=scene.device.motions(scene.channels),
        written=scene.written,
        in_plane=tuple((x, y) for x, y, *_ in scene.channel_groups) if scene.space > 1 else (),
        timed_by_device=bool(loop.record.watch.period_ns),
        beyond_limit=_beyond_limit(loop),
        released=True if ending == endings.IN_WORDS[endings.DEVICE_STOPPED] and _is_released(loop) else None,
        **counters_of(loop),
    )
    return report, statistics


def _beyond_limit(loop: LoopMemory) -> str:
    """Returns a sentence, without a full stop, about the hand that is farthest beyond what its force limit holds; "" if
    none is."""
    scene, io = loop.rendered_scene, loop.record.io
    points = [one for one in scene.device_points.values() if one.channel < scene.channels]  # none away
    hands = {one: list(scene.hand_of(one.channel)) for one in points}
    asked = {one: math.hypot(*io.asked[own]) for one, own in hands.items()}  # in numpy a great one would warn
    hand = max(hands, key=lambda one: asked[one] - _FAR_BEYOND * io.force_limit[one.channel], default=None)
    if hand is None or not asked[hand] > _FAR_BEYOND * io.force_limit[hand.channel]:
        return ""
    units, most = scene.units_of(hand.channel), float(io.force_limit[hand.channel])
    place = units(", ".join(units.number(one, "m", ".3g") for one in io.measured[hands[hand]]), "m")
    return (
        f"{scene.hand_on(hand.channel)} was at {place} when the run ended, where the scene asks for "
        f"{units(asked[hand], 'N', '.3g')}: the force limit of {units(most, 'N', '.3g')} does not hold a hand there"
    )


def _is_released(loop: LoopMemory) -> bool:
    """Returns whether the device's last STATUS means zero force: a device releases its force before it reports that."""
    return int(loop.state.device_state) in (schema.IDLE, schema.LATCHED)


# In words


def failure_of(name: str, scene: Scene, loop: LoopMemory, trace: Trace, ending: int) -> RunError | None:
    """Returns the error, with the trace, of a run that failed or whose device did not release; None for any other."""
    report = trace.report
    ended = "another device failed" if ending == endings.OTHER_PORT else "the run ended normally"
    guard, advice, frozen = guard_that_ended(ending), "", ""
    kind: type[RunError]
    if guard is not None:
        run = EndedRun(loop.record, report, loop.rendered_scene, loop.setting)
        kind, what, advice = GuardError, guard.sentence(run), guard.advice(run)
    elif ending in _FAILURES:
        kind, sentence = _FAILURES[ending]
        what = sentence(loop, report) if callable(sentence) else sentence.format(report=report)
        advice = _slowness(loop, report, ending)
    elif not report.released:
        kind, what = DeviceError, f"{ended} after {report.ticks} ticks"
    elif withheld := (frozen := _frozen_at_end(loop)) or _late_at_end(loop):
        kind, what = GuardError, f"{ended} after {report.ticks} ticks, without force: "
        what += "" if frozen else withheld
    else:
        return None
    if kind is GuardError and (hints := " ".join(unlikely(scene)).removesuffix(".")):
        advice = f"A likely mistake: {hints}"
    advice = f". {advice}" if advice else ""
    state = _force_state(scene, loop, bool(report.released))
    error = kind(f"{name}: {what}", frozen, ". " * bool(sensor := report.wrong_sensor), sensor, advice, f"; {state}")
    error.sensors = {key: at for key, at in (("frozen", 1), ("wrong_sensor", 3)) if error.args[at]}
    error.held_up = kind is DeviceError and bool(advice)
    return _with_trace(error, trace)


def with_sentence(failure: RunError, sentence: str) -> RunError:
    """Returns the error with a sentence added."""
    found = type(failure)(*failure.args, sentence)
    found.sensors, found.held_up = failure.sensors, failure.held_up
    return _with_trace(found, failure.trace)


def file_failure(failure: RunError | None, name: str, file: BackgroundFile | None, trace: Trace) -> RunError | None:
    """Returns the error of a run, extended by the reason if a file of it is incomplete."""
    if file is None or not file.problem:
        return failure
    if failure is not None:
        return with_sentence(failure, f". And {file.problem}")
    ended = f"{name}: the run ended normally after {trace.report.ticks} ticks, but {file.problem}"
    return _with_trace(RecordError(ended), trace)


def _with_trace(error: RunError, trace: Trace | None) -> RunError:
    error.trace = trace
    return error


def _silent(loop: LoopMemory, report: Report) -> str:
    silence = f"for {duration(loop.control.silence_ns * 1e-9)} after {report.ticks} ticks"
    useless = _useless_input(loop, report)
    if not useless:
        return f"the device was silent {silence}"
    return f"no usable position came from the device {silence} (in this run {useless})"


def _device_stopped(loop: LoopMemory, report: Report) -> str:
    return f"the device stopped after {report.ticks} ticks: {_stop_reason(loop, report)}"


_FAILURES: dict[int, tuple[type[RunError], str | Callable[[LoopMemory, Report], str]]] = {
    endings.SILENT: (DeviceError, _silent),
    endings.HUNG_UP: (DeviceError, "the device went away after {report.ticks} ticks (unplugged, or its port closed)"),
    endings.FAILED: (
        DeviceError,
        "the port failed after {report.ticks} ticks: it took no bytes for 0.1 s, or the system refused to read it",
    ),
    endings.DEVICE_STOPPED: (DeviceError, _device_stopped),
    endings.NOT_FINITE: (
        GuardError,
        "the scene's force was not a finite number at tick {report.ticks}, and was not sent. The scene has grown "
        "without bounds, or a stiffness or a damping is beyond what floating point holds at this rate: `hapsim check` "
        "reports what is stable",
    ),
}
"""Error class and sentence without a full stop, or a function that returns it, by ending without a guard."""


def _frozen_at_end(loop: LoopMemory) -> str:
    """Returns a sentence, without a full stop, if a guard withheld the force for at least the last second because a
    position stands still; "" if none did."""
    sensor, io = loop.record.frozen_sensor, loop.record.io
    period_s, is_asked = 1e-9 * int(loop.control.period_ns), np.abs(io.asked) > sensor.floor
    still_s = sensor.still * sensor.frozen * is_asked * period_s
    if still_s.max() < _TELLING_S:
        return ""
    return frozen_sentence(loop.rendered_scene, int(np.argmax(still_s)), float(still_s.max()))


def _late_at_end(loop: LoopMemory) -> str:
    """Returns the same if all positions are too old."""
    state = loop.state
    late_s = 1e-9 * (int(state.sent_ns) - int(state.withheld_ns)) if state.withheld_ns else 0.0
    if late_s < _TELLING_S:
        return ""
    return (
        f"for {duration(late_s)} every position was too old to be answered. {STEADINESS_ADVICE}; or something between "
        "it and the device holds bytes back"
    )


def _useless_input(loop: LoopMemory, report: Report) -> str:
    """Returns a phrase for the useless input; "" if there was none."""
    counts = (
        (report.crc_errors, "refused frame"),
        (report.garbage_bytes, "byte of no frame", "bytes of no frame"),
        (int(loop.state.old_positions), "repeated position"),
    )
    return ", ".join(plural(count, *nouns) for count, *nouns in counts if count)


def _slowness(loop: LoopMemory, report: Report, ending: int) -> str:
    """Returns a sentence, without a full stop, if this machine was too slow for the run; "" if nothing shows that."""
    is_quiet = ending == endings.DEVICE_STOPPED and _is_released(loop) and int(loop.state.fault) == schema.HOST_QUIET
    if not is_quiet and ending != endings.SILENT:
        return ""
    watchdog_s, position_s, force_s = _times_before_stop(loop)
    # Time for which this program could have sent a force and did not; if the host paces: how late it woke up.
    held_up_s = force_s if report.ticks and position_s < 0.5 * watchdog_s else 0.0
    if int(loop.control.clock) == HOST_CLOCK:
        held_up_s = report.lateness_s.max or 0.0
    advice = STEADINESS_ADVICE + _PACED_ADVICE * loop.has_own_mock
    if is_quiet and held_up_s > watchdog_s:
        return f"This program, or its port, was held up for {duration(held_up_s)}. {advice}"
    return f"This machine held up the mock, which runs in this program. {advice}" * loop.has_own_mock


def _times_before_stop(loop: LoopMemory) -> tuple[float, float, float]:
    """Returns the device's watchdog, and how long before its stop the last position came and the last force left, s."""
    state, watchdog_s = loop.state, 1e-9 * loop.watchdog_samples * int(loop.control.period_ns)
    position_s, force_s = (1e-9 * (int(state.stopped_ns) - int(ns)) for ns in (state.newest_ns, state.sent_ns))
    return watchdog_s, position_s, force_s


def _stop_reason(loop: LoopMemory, report: Report) -> str:
    """Returns the device's reason for its stop; if its watchdog expired, also the last events at this host."""
    state, fault = loop.state, int(loop.state.fault)
    if not _is_released(loop):
        return (
            f"it sent a STATUS with state {state.device_state} and fault {fault}, where an armed device says only that "
            "it is idle or latched (PROTOCOL.md, section 7)"
        )
    if fault != schema.HOST_QUIET:
        return fault_text(fault) + (
            at_end_of_counts(loop.record.io, loop.rendered_scene) if fault == schema.POSITION_OUT_OF_RANGE else ""
        )
    _, position_s, force_s = _times_before_stop(loop)
    useless = _useless_input(loop, report)
    before = [
        f"the last usable position arrived {duration(position_s)} before" if report.ticks else "no position was usable",
        f"the last force left {duration(force_s)} before",
        *([f"arrived: {useless}"] if useless else []),
    ]
    return f"{fault_text(fault)} ({loop.watchdog_samples} samples): {', '.join(before)}"


def _force_state(scene: Scene, loop: LoopMemory, released: bool) -> str:
    """Returns a sentence about the force after the end of the loop, and the remedy."""
    if released:
        zero = "torque is off" if scene.device.is_admittance else "force is zero"
        return f"the {zero}: the device confirmed that it released it"
    silence = host_silence(scene.rate, loop.watchdog_samples)
    by_itself = f"when its watchdog ends, {duration(silence.latched_after_s)} after the last force"
    if scene.device.is_admittance:
        ends = f"{duration(silence.latched_after_s)} after the last command"
        by_itself = f"half a second after it has braked to rest and its watchdog has ended, {ends}"
    elif scene.device.clock == "device":
        lives_s = silence.zero_force_after_s + 1.0 / scene.rate  # it begins to act at the next tick
        by_itself = f"when its force's time to live is over, {duration(lives_s)} after the last one, or {by_itself}"
    if scene.device.clock == "lockstep":
        by_itself = "10 s after the last force"
    return (
        "hapsim tried to disarm it, but the device did not confirm that it released its force: one that keeps "
        f"PROTOCOL.md, section 7, does so by itself {by_itself}. If it still pushes, power it off"
    )
