"""How a run went, in numbers, and how it ended: the error of a run that did not end as asked."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.device.connection import fault_text
from hapsim.errors import DeviceError, GuardError, RecordError, RunError
from hapsim.loop import endings
from hapsim.loop.counts import Progress, words_at
from hapsim.loop.exchange import HOST_CLOCK
from hapsim.loop.guards.energy_guard import GIVEN, LATE, SHAKING, SWINGING
from hapsim.loop.guards.slew import NO_LIMIT
from hapsim.loop.histogram import histogram_of
from hapsim.number_format import duration, plural, rounded_down, rounded_up
from hapsim.prediction import unlikely
from hapsim.prediction.timing import host_silence
from hapsim.recording.background_file import BackgroundFile
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Report, Statistics, Trace, columns_of
from hapsim.running.assemble import LoopMemory
from hapsim.scene import Scene

_MUCH_SLEWED = 0.1  # of all ticks
_COUNTS, _NEAR_END = 2.0**31, 0.99  # to either side; a device that wraps round was nearer in the sample before
_STEADIER = "`hapsim doctor` reports what would help this machine, and `--realtime` requests it"


def trace_of(scene: Scene, loop: LoopMemory, recorder: Recorder, ending: int) -> Trace:
    """Returns everything that was recorded of a loop that has ended."""
    return Trace(
        scene.rate,
        **columns_of(recorder.rows()),
        position_scale=loop.record.io.position_scale[: loop.wire.channels].copy(),
        force_scale=loop.record.io.force_scale[: loop.wire.channels].copy(),
        statistics=statistics_of(loop),
        report=report_of(scene, loop, endings.IN_WORDS[ending]),
    )


def statistics_of(loop: LoopMemory) -> Statistics:
    """Returns the histograms of a loop as they are now, in s and in samples."""
    counted = loop.record.histograms
    return Statistics(
        lateness=histogram_of(counted.lateness, 1e-9),
        exchange=histogram_of(counted.exchange, 1e-9),
        age=histogram_of(counted.age),
    )


def progress_of(loop: LoopMemory) -> Progress:
    """Returns the state of a loop now."""
    state, io, used = loop.state, loop.record.io, slice(loop.wire.channels)
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    sensor, period_s = loop.record.frozen_sensor, 1e-9 * int(loop.control.period_ns)
    now_s = sensor.still * sensor.frozen * period_s
    return Progress(
        "running",
        elapsed_s=elapsed,
        rate_hz=(int(state.ticks) - 1) / elapsed if elapsed > 0 else 0.0,
        force=tuple((io.force_counts * io.force_scale)[used].tolist()),
        position=tuple(io.measured[used].tolist()),
        age_samples=int(state.age),
        frozen=_frozen_sensor(loop, int(np.argmax(now_s)), float(now_s.max())),
        **counters_of(loop),
    )


def counters_of(loop: LoopMemory) -> dict[str, Any]:
    """Returns what a loop counted and estimated, by the names of `Counts`, without what is said of a position that
    stands still."""
    decoder, record, wire = loop.inbox.decoder, loop.record, loop.wire
    counts = {
        name: int(attrgetter(f"state.{name}" if at == "state" else at)(record)) for name, at in words_at("at").items()
    }
    pending = int(decoder.seen)  # bytes since the last delimiter: garbage where there are more than a frame has
    is_frame = pending <= schema.frame_bytes(wire.channels, to_device=False, velocity=wire.velocity)
    counts |= {
        "parameter_changes": loop.changes,
        "crc_errors": int(decoder.crc_errors + decoder.length_errors + decoder.form_errors),
        "garbage_bytes": int(decoder.garbage_bytes) + (0 if is_frame else pending),
        "slowed_ticks": -(-int(record.tank.slowed_ticks) // int(record.slot.substeps)),
    }
    masses = {} if loop.correction is None else loop.correction.masses(loop.wire.channels)
    sound = {} if loop.sound_output is None else loop.sound_output.counts()
    return counts | masses | sound


def report_of(scene: Scene, loop: LoopMemory, ending: str) -> Report:
    """Returns the report of a loop, while it runs or afterwards."""
    state, statistics, sensor = loop.state, statistics_of(loop), loop.record.frozen_sensor
    virtual = scene.device.clock == "lockstep"
    samples = max(int(state.ticks) - 1, 0)
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    if virtual:
        elapsed = (samples + int(state.lost_frames)) / scene.rate
    return Report(
        ending=ending,
        duration_s=elapsed,
        rate_hz=samples / elapsed if elapsed > 0 else 0.0,
        nominal_rate_hz=scene.rate,
        frozen=_frozen_sensor(loop, int(sensor.channel), float(sensor.longest / scene.rate)),
        lateness_s=statistics.lateness.spread(),
        exchange_s=statistics.exchange.spread(),
        age_samples=statistics.age.spread(),
        virtual_time=virtual,
        motion=scene.device.motions(scene.channels),
        timed_by_device=bool(loop.record.watch.judges),
        released=True if ending == endings.IN_WORDS[endings.DEVICE_STOPPED] and _says_released(loop) else None,
        **counters_of(loop),
    )


def _says_released(loop: LoopMemory) -> bool:
    """Whether the device's last STATUS says that its force is zero: a device releases it before it says so."""
    return int(loop.state.device_state) in (schema.IDLE, schema.LATCHED)


# In words


def failure_of(name: str, scene: Scene, loop: LoopMemory, trace: Trace, ending: int) -> RunError | None:
    """Returns the error, with the trace, of a run that did not end as asked or whose device did not release."""
    report = trace.report
    kind, sentence = _FAILURES.get(ending, (DeviceError, None))
    if sentence is None and report.released:
        return None
    sentence = sentence or "the run ended as asked after {report.ticks} ticks"
    what = sentence(loop, report) if callable(sentence) else sentence.format(loop=loop.record, report=report)
    hints = " ".join(unlikely(scene)).removesuffix(".") if kind is GuardError else ""
    if advice := f"A likely mistake: {hints}" if hints else _stability_advice(loop, report, ending):
        what = f"{what}. {advice}"
    what = f"{what}; {_where_the_force_is(scene, loop, bool(report.released))}"
    return _with_trace(kind(f"{name}: {what}"), trace)


def with_sentence(failure: RunError, sentence: str) -> RunError:
    """Returns the same error with a sentence added."""
    return _with_trace(type(failure)(f"{failure}{sentence}"), failure.trace)


def file_failure(failure: RunError | None, name: str, file: BackgroundFile | None, trace: Trace) -> RunError | None:
    """Returns the error of a run, with the reason why a file of it is incomplete, if it is."""
    if file is None or not file.problem:
        return failure
    if failure is not None:
        return with_sentence(failure, f". And {file.problem}")
    ended = f"{name}: the run ended as asked after {trace.report.ticks} ticks, and {file.problem}"
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


def _hand_on(loop: LoopMemory, channel: int) -> str:
    return next(name for name, one in loop.rendered_scene.device_points.items() if one.channel == channel)


def _frozen_sensor(loop: LoopMemory, channel: int, still_s: float) -> str:
    """Returns what a position that does not answer may be, without a full stop; "" where it did not stand still."""
    if still_s == 0.0:
        return ""
    return (
        f"the position of {_hand_on(loop, channel)} has not changed by one count for {duration(still_s)} although "
        "force acted: sensor or cable? Its force is zero until it changes. For a handle at a stop declare "
        "device.travel, and for one with dry friction mock.coulomb"
    )


def _staircase(loop: LoopMemory, report: Report) -> str:
    return (
        f"the position of {_hand_on(loop, int(loop.record.frozen_sensor.jumps_on))} stands still and jumps, again and "
        f"again, the last time at tick {report.ticks}: its sensor is refreshed more rarely than device.rate says, or "
        "its cable is loose; the last force was not sent (hapsim/STABILITY.md)"
    )


def _out_of_travel(loop: LoopMemory, report: Report) -> str:
    travel, c = loop.record.travel, int(loop.record.travel.channel)
    units = loop.rendered_scene.units_of(c)
    return (
        f"channel {c} is out of its travel at tick {report.ticks}: at {units(travel.position, 'm', '.6g')}, where "
        f"device.travel goes from {units.number(travel.low[c], 'm', 'g')} to {units(travel.high[c], 'm', 'g')} and the "
        "force fades within "
        f"{units(travel.margin[c], 'm', 'g')} outside; its force was not sent. Something drives the device outward, or "
        "its zero is "
        "not where the scene has it: a motor or an encoder with the wrong sign, a wrong device.origin, a device that "
        "restarted elsewhere, or limits that are not the device's. Move it back within its travel before the next run"
    )


def _too_late(loop: LoopMemory, report: Report) -> str:
    return (
        f"{report.deadline_misses} of the first {report.ticks} forces were late: the scene is unstable on a wire that "
        f"takes {loop.first_late} Use a faster wire, a lower rate or less stiffness; --unstable runs it all the same"
    )


def _position_leapt(loop: LoopMemory, report: Report) -> str:
    leap = loop.record.leap
    units = loop.rendered_scene.units_of(int(leap.channel))
    bound = units(rounded_down(units.scaled(leap.bound_m, "m")), "m")
    return (
        f"the position of channel {leap.channel} leapt at tick {report.ticks}: {units(leap.leapt_m, 'm', '.4g')} away "
        "from "
        f"where its motion led, where no hand gets farther than {bound} (hapsim/STABILITY.md); "
        "its force was not sent. A loose cable, a sensor or counter that jumps, or a position scale, a mass or a "
        f"force_limit that is not the device's{_at_end_of_counts(loop, _NEAR_END)}"
    )


def _at_end_of_counts(loop: LoopMemory, near: float) -> str:
    """A sentence where a channel's position is beyond this share of what its counts can say; else ""."""
    io, n = loop.record.io, loop.wire.channels
    counts = [abs(int(io.position_counts[c]) + int(io.origin_counts[c])) for c in range(n)]
    c = max(range(n), key=lambda one: counts[one])
    if counts[c] < near * _COUNTS:
        return ""
    scale, units = float(io.position_scale[c]), loop.rendered_scene.units_of(c)
    return (
        f". The position's count is at its end on channel {c} (±{units(_COUNTS * scale, 'm', '.4g')} at "
        f"{units(scale, 'm', 'g')} per count): the "
        "device went as far as 32 bits reach. Keep it within by a spring, a stop or device.travel, or make its counts "
        "larger: mock.quantum, or the position scale of a device's firmware"
    )


def _diverging(loop: LoopMemory, report: Report) -> str:
    """Returns what the energy guard found, and what to do about late forces."""
    energy = loop.record.energy_guard
    why, account = int(energy.why), int(energy.account)
    is_unstable = loop.energy_guard is not None and loop.energy_guard.is_unstable
    alike = "each time as far, by late forces" if account == LATE else "faster than any hand moves"
    on_what = "on a scene that is predicted unstable" if is_unstable else ""
    if why == SWINGING:
        found = (
            f"the force swung {on_what or 'at its limit'}: {energy.swings[account]} times in a row, the last at tick "
            f"{report.ticks}, and gave the hand {rounded_up(energy.work[account])} J over these, above the limit of "
            f"{rounded_down(energy.swing_limit[account])} J and no less than the declared friction takes"
        )
    elif why == SHAKING:
        found = (
            f"the force shook at its limit: from one side to the other {energy.shakes} times in a row, the last at "
            f"tick {report.ticks}, {on_what or alike}"
        )
    else:
        found = (
            f"by tick {report.ticks} {'late forces' if account == LATE else 'the scene'} had given the hand "
            f"{rounded_up(energy.given[account])} J that it had not got from it, above the limit of "
            f"{rounded_down(energy.limit[account])} J"
        )
    late = f". {_late_force_advice(report)}" if account == LATE else ""
    return f"{found}; the last force was not sent{late}"


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
    endings.WRONG_RATE: (
        GuardError,
        "the device samples at {loop.watch.rate_hz:.4g} Hz, where it declares {report.nominal_rate_hz:g} Hz; stopped "
        "after {report.ticks} ticks. At another rate than the scene's, stiffness and damping feel different: set the "
        "device's timer right",
    ),
    endings.TOO_LATE: (GuardError, _too_late),
    endings.POSITION_LEAPT: (GuardError, _position_leapt),
    endings.OUT_OF_TRAVEL: (GuardError, _out_of_travel),
    endings.STAIRCASE: (GuardError, _staircase),
    endings.WRONG_SIGN: (
        GuardError,
        "motor and position of channel {loop.sign.channel} disagree in sign: the device accelerated against its force, "
        "and a release of the force confirmed it (tick {report.ticks}). Swap the motor's two wires; or reverse the "
        "encoder, if the position falls when the hand moves the positive way (hapsim/STABILITY.md)",
    ),
    endings.ENERGY_EXCEEDED: (GuardError, _diverging),
}
"""By ending: the kind of error, and its sentence without a full stop, or a function that returns it."""


def _late_force_advice(report: Report) -> str:
    late_s = ((report.age_samples.max or 1.0) - 1.0) / report.nominal_rate_hz
    lost = f", and {report.lost_frames} positions were lost" if report.lost_frames else ""
    return (
        f"{report.deadline_misses} forces were up to {duration(late_s)} late{lost}; in time the scene would have given "
        f"no more than it may. {_STEADIER} (hapsim/STABILITY.md)"
    )


def _stability_advice(loop: LoopMemory, report: Report, ending: int) -> str:
    """Returns what to change in a scene in which no value is unlikely; first the slew limit, where it held the force
    back in many ticks. "" where it was not the scene's motion that ended the run."""
    energy = loop.record.energy_guard
    if ending != endings.ENERGY_EXCEEDED or int(energy.account) == LATE:
        return ""
    advice = "" if loop.energy_guard is not None and loop.energy_guard.is_unstable else "No passive object does that. "
    if report.slewed_ticks > _MUCH_SLEWED * report.ticks:
        slew, limited = loop.record.slew, int(loop.record.slew.step[0]) < NO_LIMIT
        by = " or ".join(["device.slew_limit"] * limited + ["device.soft_start"] * (float(slew.soft_samples) > 0.0))
        advice = (
            f"{by} held the force back in {report.slewed_ticks} of {report.ticks} ticks, which predictions ignore: "
            f"a force that comes late can shake what is stable otherwise. Change it first. {advice}"
        )
    limit = (
        "For a scene that is meant to give energy, set device.energy_limit"
        if int(energy.why) == GIVEN
        else "A larger device.energy_limit does not change that"
    )
    return (
        f"{advice}`hapsim check` reports what would make the scene stable; less stiffness, more real friction, a "
        f"higher rate or a shorter delay. {limit} (hapsim/STABILITY.md)"
    )


def _useless_input(loop: LoopMemory, report: Report) -> str:
    """Returns what arrived and was of no use; "" if all was."""
    counts = (
        (report.crc_errors, "refused frame"),
        (report.garbage_bytes, "byte of no frame", "bytes of no frame"),
        (int(loop.state.old_positions), "repeated position"),
    )
    return ", ".join(plural(count, *nouns) for count, *nouns in counts if count)


def _stop_reason(loop: LoopMemory, report: Report) -> str:
    """Returns why the device stopped, as it says; where its watchdog expired, also what this host saw before."""
    state, fault = loop.state, int(loop.state.fault)
    if not _says_released(loop):
        return (
            f"it sent a STATUS with state {state.device_state} and fault {fault}, where an armed device says only that "
            "it is idle or latched (PROTOCOL.md, section 7)"
        )
    if fault != schema.HOST_QUIET:
        return fault_text(fault) + (_at_end_of_counts(loop, 0.0) if fault == schema.POSITION_OUT_OF_RANGE else "")
    watchdog_s = 1e-9 * loop.watchdog_samples * int(loop.control.period_ns)
    position_s, force_s = (1e-9 * (int(state.stopped_ns) - int(ns)) for ns in (state.newest_ns, state.sent_ns))
    useless = _useless_input(loop, report)
    before = [
        f"the last usable position arrived {duration(position_s)} before" if report.ticks else "no position was usable",
        f"the last force left {duration(force_s)} before",
        *([f"arrived: {useless}"] if useless else []),
    ]
    # How long this program could have sent a force and did not; where the host paces: how late it woke up.
    held_up_s = force_s if report.ticks and position_s < 0.5 * watchdog_s else 0.0
    if int(loop.control.clock) == HOST_CLOCK:
        held_up_s = report.lateness_s.max or 0.0
    held_up = f". This program, or its port, was held up for {duration(held_up_s)}. {_STEADIER}"
    return (
        f"{fault_text(fault)} ({loop.watchdog_samples} samples): {', '.join(before)}"
        f"{held_up if held_up_s > watchdog_s else ''}"
    )


def _where_the_force_is(scene: Scene, loop: LoopMemory, released: bool) -> str:
    """Returns what is known of the force after the end of the loop, and what to do."""
    if released:
        return "the force is zero: the device confirmed that it released it"
    silence = host_silence(scene.rate, loop.watchdog_samples)
    by_itself = f"when its watchdog ends, {duration(silence.latched_after_s)} after the last force"
    if scene.device.clock == "device":
        lives_s = silence.zero_force_after_s + 1.0 / scene.rate  # it begins to act at the next tick
        by_itself = f"when its force's time to live is over, {duration(lives_s)} after the last one, or {by_itself}"
    if scene.device.clock == "lockstep":
        by_itself = "10 s after the last force"
    return (
        "hapsim tried to disarm it, but the device did not confirm that it released its force: one that keeps "
        f"PROTOCOL.md, section 7, does so by itself {by_itself}. If it still pushes, power it off"
    )
