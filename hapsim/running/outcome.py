"""How a run went, in numbers, and how it ended: the error of a run that did not end as asked."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from firmware_protocol import schema
from hapsim.device.conversation import fault_text
from hapsim.errors import DeviceError, GuardError, RecordError, RunError
from hapsim.loop import endings
from hapsim.loop.exchange import DEVICE_CLOCK, HOST_CLOCK
from hapsim.loop.guards.energy_guard import GIVEN, LATE, SHAKING, SWINGING
from hapsim.loop.guards.slew import NO_LIMIT
from hapsim.loop.histogram import histogram_of
from hapsim.prediction.timing import host_silence
from hapsim.progress import Progress
from hapsim.recording.recorder import Recorder, RecordFile
from hapsim.recording.trace import Report, Statistics, Trace, columns_of
from hapsim.running.assemble import LoopMemory
from hapsim.scene import Scene

_MUCH_SLEWED = 0.1  # of all ticks


# In numbers


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
    state, io = loop.state, loop.record.io
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    ticks = int(state.ticks)
    return Progress(
        "running",
        elapsed_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        force=tuple((io.force_counts * io.force_scale)[: loop.wire.channels].tolist()),
        position=tuple(io.measured[: loop.wire.channels].tolist()),
        age_samples=int(state.age),
        ticks=ticks,
        **_counts_of(loop),
    )


def _counts_of(loop: LoopMemory) -> dict[str, Any]:
    """What Progress and Report have in common."""
    counts = ("deadline_misses", "limited_ticks", "slewed_ticks", "faded_ticks")
    masses = {} if loop.correction is None else loop.correction.masses(loop.wire.channels)
    slowed = {"slowed_ticks": int(loop.record.tank.slowed_ticks)}
    return {name: int(getattr(loop.state, name)) for name in counts} | slowed | masses


def report_of(scene: Scene, loop: LoopMemory, ending: str) -> Report:
    """Returns the report of a loop, while it runs or afterwards."""
    state, decoder, virtual = loop.state, loop.inbox.decoder, scene.device.clock == "lockstep"
    ticks = int(state.ticks)
    samples = max(ticks - 1, 0)
    elapsed = (
        (samples + int(state.lost_frames)) / scene.rate
        if virtual
        else (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    )
    statistics = statistics_of(loop)
    return Report(
        ending=ending,
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=samples / elapsed if elapsed > 0 else 0.0,
        nominal_rate_hz=scene.rate,
        lost_frames=int(state.lost_frames),
        crc_errors=int(decoder.crc_errors + decoder.length_errors + decoder.form_errors),
        stale_positions=int(state.stale_positions),
        withheld_forces=int(state.withheld_forces),
        sign_tests=int(loop.record.sign.tests),
        dropped_rows=int(loop.record.ring.dropped),
        parameter_changes=loop.changes,
        lateness_s=statistics.lateness.spread(),
        exchange_s=statistics.exchange.spread(),
        age_samples=statistics.age.spread(),
        virtual_time=virtual,
        garbage_bytes=int(decoder.garbage_bytes) + _unfinished_bytes(loop),
        timed_by_device=bool(loop.record.watch.judges),
        released=True if ending == endings.IN_WORDS[endings.DEVICE_STOPPED] and _says_released(loop) else None,
        **_counts_of(loop),
    )


def _says_released(loop: LoopMemory) -> bool:
    """Whether the device's last STATUS says that its force is zero: a device releases it before it says so."""
    return int(loop.state.device_state) in (schema.IDLE, schema.LATCHED)


def _unfinished_bytes(loop: LoopMemory) -> int:
    """Bytes since the last delimiter, where there are more than a frame has."""
    pending, wire = int(loop.inbox.decoder.seen), loop.wire
    return pending if pending > schema.frame_bytes(wire.channels, to_device=False, velocity=wire.velocity) else 0


# In words


def failure_of(name: str, scene: Scene, loop: LoopMemory, trace: Trace, ending: int) -> RunError | None:
    """Returns the error of a run that did not end as asked, or whose device did not confirm that it released the
    force; it carries the trace. `name`: the port, as the user calls it."""
    kind, sentence = _FAILURES.get(ending, (DeviceError, None))
    if sentence is None and trace.report.released:
        return None
    if sentence is None:
        sentence = "the run ended as asked after {ticks} ticks"
    what = sentence(loop, trace) if callable(sentence) else sentence.format(ticks=trace.report.ticks)
    error = kind(f"{name}: {what}; {_where_the_force_is(scene, loop, bool(trace.report.released))}")
    error.trace = trace
    return error


def with_sentence(failure: RunError, sentence: str) -> RunError:
    """Returns the same error with a sentence added."""
    longer = type(failure)(f"{failure}{sentence}")
    longer.trace = failure.trace
    return longer


def record_failure(failure: RunError | None, name: str, record: RecordFile | None, trace: Trace) -> RunError | None:
    """Returns the error of a run with why its record is not what was asked for, where that is so."""
    if record is None or not record.problem:
        return failure
    if failure is not None:
        return with_sentence(failure, f". And {record.problem}")
    error = RecordError(f"{name}: the run ended as asked after {trace.report.ticks} ticks, and {record.problem}")
    error.trace = trace
    return error


def _silent(loop: LoopMemory, trace: Trace) -> str:
    silence = f"for {loop.control.silence_ns * 1e-9:.2g} s after {trace.report.ticks} ticks"
    useless = _useless_input(loop, trace.report)
    if not useless:
        return f"the device was silent {silence}"
    return f"no position of the device that could be used came {silence} (in this run {useless})"


def _device_stopped(loop: LoopMemory, trace: Trace) -> str:
    return f"the device stopped after {trace.report.ticks} ticks: {_stop_reason(loop, trace.report)}"


def _wrong_rate(loop: LoopMemory, trace: Trace) -> str:
    return (
        f"the device samples at {loop.record.watch.rate_hz:.4g} Hz, where it declares {trace.rate:g} Hz; "
        f"stopped after {trace.report.ticks} ticks. At another rate than the scene's no stiffness and no "
        "damping is what it says: set the device's timer right"
    )


def _position_leapt(loop: LoopMemory, trace: Trace) -> str:
    leap = loop.record.leap
    leapt, bound = _distinct(float(leap.leapt_m), float(leap.bound_m))
    return (
        f"the position of channel {int(leap.channel)} leapt at tick {trace.report.ticks}: {leapt} m away "
        f"from where its motion led, where no hand gets farther than {bound} m (hapsim/STABILITY.md); "
        "its force was not sent. A loose cable, a sensor or counter that jumps, or a position scale, a mass or a "
        "force_limit that is not the device's"
    )


def _out_of_travel(loop: LoopMemory, trace: Trace) -> str:
    travel, c = loop.record.travel, int(loop.record.travel.channel)
    return (
        f"channel {c} is out of its travel at tick {trace.report.ticks}: at {travel.position:.6g} m, where "
        f"device.travel goes from {travel.low[c]:g} to {travel.high[c]:g} m and the force fades within "
        f"{travel.margin[c]:g} m outside; its force was not sent. Something drives the device outward, or its zero is "
        "not where the scene has it: a motor or an encoder with the wrong sign, a wrong device.origin, a device that "
        "restarted elsewhere, or limits that are not the device's. Move it back within its travel before the next run"
    )


def _sign_wrong(loop: LoopMemory, trace: Trace) -> str:
    return (
        f"motor and position of channel {int(loop.record.sign.channel)} disagree in sign: the device "
        f"accelerated against its force, and a release of the force confirmed it (tick {trace.report.ticks}). Swap "
        "the motor's two wires; or reverse the encoder, if the position falls when the hand moves the positive way "
        "(hapsim/STABILITY.md)"
    )


def _diverging(loop: LoopMemory, trace: Trace) -> str:
    """What the energy guard found, and what to do."""
    energy, report = loop.record.energy_guard, trace.report
    is_unstable = loop.energy_guard is not None and loop.energy_guard.is_unstable
    why, account = int(energy.why), int(energy.account)
    advice = _late_force_advice(report) if account == LATE else _stability_advice(loop, report, is_unstable, why)
    if why == SWINGING:
        swung = "on a scene that is predicted unstable:" if is_unstable else "at its limit: it swung into it"
        less = "no less than" if energy.gained[account] >= 0.0 else "nearly what"
        work, limit = _distinct(float(energy.work[account]), float(energy.swing_limit[account]))
        return (
            f"the force swung {swung} {int(energy.swings[account])} times in a row, the last at tick {report.ticks}, "
            f"and gave the hand {work} J over these, above the limit of {limit} J and {less} the declared friction "
            f"takes; the last force was not sent. {advice}"
        )
    if why == SHAKING:
        where = "on a scene that is predicted unstable" if is_unstable else "faster than any hand moves"
        return (
            f"the force shook at its limit: from one side to the other {int(energy.shakes)} times in a row, the last "
            f"at tick {report.ticks}, {where}; the last force was not sent. {advice}"
        )
    given, limit = _distinct(float(energy.given[account]), float(energy.limit[account]))
    who = "late forces" if account == LATE else "the scene"
    return (
        f"by tick {report.ticks} {who} had given the hand {given} J that it had not got from it, above "
        f"its limit of {limit} J; the last force was not sent. {advice}"
    )


_FAILURES: dict[int, tuple[type[RunError], str | Callable[[LoopMemory, Trace], str]]] = {
    endings.SILENT: (DeviceError, _silent),
    endings.HUNG_UP: (
        DeviceError,
        "the device went away after {ticks} ticks (unplugged, or its port was closed)",
    ),
    endings.FAILED: (
        DeviceError,
        "the port failed after {ticks} ticks: it took no bytes for 0.1 s, or the system refused to read it",
    ),
    endings.DEVICE_STOPPED: (DeviceError, _device_stopped),
    endings.NOT_FINITE: (
        GuardError,
        "the scene's force was not a finite number at tick {ticks}, and was not sent. The scene has grown without "
        "bounds, or a stiffness or a damping is beyond what floating point holds at this rate: `hapsim check` tells "
        "what is stable",
    ),
    endings.WRONG_RATE: (GuardError, _wrong_rate),
    endings.POSITION_LEAPT: (GuardError, _position_leapt),
    endings.OUT_OF_TRAVEL: (GuardError, _out_of_travel),
    endings.WRONG_SIGN: (GuardError, _sign_wrong),
    endings.ENERGY_EXCEEDED: (GuardError, _diverging),
}
"""By ending: the kind of error, and its sentence without a full stop, or a function that returns it."""


def _late_force_advice(report: Report) -> str:
    late_ms = 1e3 * ((report.age_samples.max or 1.0) - 1.0) / report.nominal_rate_hz
    lost = f", and {report.lost_frames} positions were lost" if report.lost_frames else ""
    return (
        f"{report.deadline_misses} forces were up to {late_ms:.3g} ms late{lost}; in time the scene would have given "
        "no more than it may. `hapsim doctor` tells what would help this machine, and `--realtime` asks for it "
        "(hapsim/STABILITY.md)"
    )


def _stability_advice(loop: LoopMemory, report: Report, is_unstable: bool, why: int) -> str:
    tells = (
        "`hapsim check` tells what would make the scene stable"
        if is_unstable
        else "No passive object does that: `hapsim check` tells whether the scene is stable, and what would make it"
    )
    limit = (
        "A scene that is meant to give energy says so with device.energy_limit"
        if why == GIVEN
        else "A larger device.energy_limit does not change that"
    )
    ways = "less stiffness, more real friction, a higher rate or a shorter delay"
    return f"{_slew_advice(loop, report)}{tells}; {ways}. {limit} (hapsim/STABILITY.md)"


def _slew_advice(loop: LoopMemory, report: Report) -> str:
    """Returns a sentence and a space where the slew limit held the force back in many ticks; else ""."""
    if report.slewed_ticks <= _MUCH_SLEWED * report.ticks:
        return ""
    slew, limited = loop.record.slew, int(loop.record.slew.step[0]) < NO_LIMIT
    by = " or ".join(["device.slew_limit"] * limited + ["device.soft_start"] * (float(slew.soft_samples) > 0.0))
    return (
        f"{by} held the force back in {report.slewed_ticks} of {report.ticks} ticks, which no prediction counts with: "
        "a force that comes later than the scene asks for it can shake what is stable without that. "
        f"Change {'device.slew_limit' if limited else by} first. "
    )


def _distinct(found: float, limit: float) -> tuple[str, str]:
    """Returns both with three digits, or with as many as it takes for them to differ."""
    for digits in range(3, 17):
        texts = f"{found:.{digits}g}", f"{limit:.{digits}g}"
        if texts[0] != texts[1]:
            return texts
    return repr(found), repr(limit)


def _useless_input(loop: LoopMemory, report: Report) -> str:
    """Returns what arrived and was of no use; "" where there was nothing."""
    counts = {
        "frame{s} {were} refused": report.crc_errors,
        "byte{s} belonged to no frame": report.garbage_bytes,
        "position{s} {were} numbered as earlier ones": int(loop.state.old_positions),
    }
    one, several = {"s": "", "were": "was"}, {"s": "s", "were": "were"}
    found = [f"{count} {what.format(**(one if count == 1 else several))}" for what, count in counts.items() if count]
    return ", ".join(found)


def _stop_reason(loop: LoopMemory, report: Report) -> str:
    """Why the device stopped, as it says. That the host was quiet is the host's doing only where it had a position."""
    state, fault = loop.state, int(loop.state.fault)
    if not _says_released(loop):
        return (
            f"it sent a STATUS with state {int(state.device_state)} and fault {fault}, where an armed device says only "
            "that it is idle or latched (PROTOCOL.md, section 7)"
        )
    if fault != schema.HOST_QUIET:
        return fault_text(fault)
    watchdog = f"its watchdog of {loop.watchdog_samples} samples"
    watchdog_s = 1e-9 * loop.watchdog_samples * int(loop.control.period_ns)
    since_s = 1e-9 * (int(state.stopped_ns) - int(state.newest_ns))
    has_heard = report.ticks > 0 and since_s < 0.5 * watchdog_s
    gap_s = _gap_s(loop, report, has_heard)
    if gap_s > watchdog_s:
        return (
            f"{fault_text(fault)}: this program, or its port, was held up for {gap_s:.2g} s, longer than the device "
            f"waits for a force ({watchdog}). Where the machine is busy, `hapsim doctor` tells what would help, and "
            "`--realtime` asks for it"
        )
    useless = _useless_input(loop, report)
    if has_heard:
        sent_s = 1e-9 * (int(state.stopped_ns) - int(state.sent_ns))
        so = ", so forces reach it late, or damaged, or not at all" if sent_s < 0.5 * watchdog_s else ""
        return (
            f"{fault_text(fault)}, it says ({watchdog}); the last force left this host {1e3 * sent_s:.3g} ms before"
            f"{so} ({useless or 'its positions arrived undamaged'})"
        )
    when = f"for {since_s:.2g} s before" if report.ticks else "at all"
    if int(loop.control.clock) == HOST_CLOCK and report.ticks:
        why = f"and the host no position {when}, though it asked for one at every tick"
    else:
        why = f"as the host got no position that it could use {when}"
    return f"it got no force that it could use within {watchdog}, {why}" + (f": {useless}" if useless else "")


def _gap_s(loop: LoopMemory, report: Report, has_heard: bool) -> float:
    """For how long this loop sent no force although it had, or could have asked for, a position; 0: not known.

    Where the device is the clock: from the last force to the STATUS, provided that positions `has_heard` until then.
    Where the host is: by how much a tick was woken late.
    """
    if int(loop.control.clock) == DEVICE_CLOCK and has_heard:
        return (int(loop.state.stopped_ns) - int(loop.state.sent_ns)) * 1e-9
    if int(loop.control.clock) == HOST_CLOCK:
        return report.lateness_s.max or 0.0
    return 0.0


def _where_the_force_is(scene: Scene, loop: LoopMemory, released: bool) -> str:
    """What is known of the force once the loop has ended, and what to do."""
    if released:
        return "the force is zero: the device confirmed that it released it"
    silence = host_silence(scene.rate, loop.watchdog_samples)
    by_itself = f"when its watchdog ends, {1e3 * silence.latched_after_s:.3g} ms after the last force"
    if scene.device.clock == "device":
        lives = 1e3 * (silence.zero_force_after_s + 1.0 / scene.rate)  # it begins to act at the next tick
        by_itself = f"when its force's time to live is over, {lives:.3g} ms after the last one, or {by_itself}"
    if scene.device.clock == "lockstep":
        by_itself = "10 s after the last force"
    return (
        "hapsim tried to disarm it, but the device did not confirm that it released its force: one that keeps "
        f"PROTOCOL.md, section 7, does so by itself {by_itself}. If it still pushes, power it off"
    )
