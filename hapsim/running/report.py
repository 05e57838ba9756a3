"""What a loop leaves behind: its trace and report, and the error where it did not end as asked."""

from __future__ import annotations

from hapsim.device.conversation import fault_text
from hapsim.errors import DeviceError, GuardError, RunError
from hapsim.loop import endings
from hapsim.loop.histogram import histogram_of
from hapsim.loop.recorder import Recorder
from hapsim.loop.trace import Report, Statistics, Trace
from hapsim.progress import Progress
from hapsim.running.assemble import Loop
from hapsim.scene import Scene


def trace_of(scene: Scene, loop: Loop, recorder: Recorder, ending: int) -> Trace:
    """Everything that was recorded of a loop that has ended."""
    return recorder.trace(
        scene.rate,
        loop.record.io.position_scale[: loop.wire.channels].copy(),
        loop.record.io.force_scale[: loop.wire.channels].copy(),
        statistics_of(loop),
        _report(scene, loop, ending),
    )


def statistics_of(loop: Loop) -> Statistics:
    """The loop's histograms as they are now, in s and in samples."""
    counted = loop.record.histograms
    return Statistics(
        lateness=histogram_of(counted.lateness, 1e-9),
        exchange=histogram_of(counted.exchange, 1e-9),
        age=histogram_of(counted.age),
    )


def progress_of(loop: Loop) -> Progress:
    """How a loop is doing."""
    state, io = loop.state, loop.record.io
    elapsed = (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    ticks = int(state.ticks)
    return Progress(
        "running",
        elapsed_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        force=tuple((io.force_counts * io.force_scale)[: loop.wire.channels].tolist()),
        age_samples=int(state.age),
        deadline_misses=int(state.deadline_misses),
        limited_ticks=int(state.limited_ticks),
    )


def _report(scene: Scene, loop: Loop, ending: int) -> Report:
    state, decoder, virtual = loop.state, loop.inbox.decoder, scene.device.clock == "lockstep"
    ticks = int(state.ticks)
    samples = max(ticks - 1, 0)
    elapsed = samples / scene.rate if virtual else (int(state.newest_ns) - int(state.first_ns)) * 1e-9
    statistics = statistics_of(loop)
    return Report(
        ending=endings.IN_WORDS[ending],
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=samples / elapsed if elapsed > 0 else 0.0,
        nominal_rate_hz=scene.rate,
        deadline_misses=int(state.deadline_misses),
        lost_frames=int(state.lost_frames),
        crc_errors=int(decoder.crc_errors + decoder.length_errors + decoder.form_errors),
        stale_positions=int(state.stale_positions),
        limited_ticks=int(state.limited_ticks),
        dropped_rows=int(loop.record.ring.dropped),
        parameter_changes=loop.changes,
        lateness_s=statistics.lateness.spread(),
        exchange_s=statistics.exchange.spread(),
        age_samples=statistics.age.spread(),
        virtual_time=virtual,
    )


def failure_of(name: str, loop: Loop, trace: Trace, ending: int) -> RunError | None:
    """The error of a loop that did not end as asked; it carries the trace. `name`: what a user calls the port."""
    error: RunError
    ticks = trace.report.ticks
    if ending == endings.SILENT:
        silence = loop.control.silence_ns * 1e-9
        error = DeviceError(f"{name}: the device was silent for {silence:.2g} s after {ticks} ticks; the force is zero")
    elif ending == endings.GONE:
        error = DeviceError(f"{name}: the device went away after {ticks} ticks (unplugged, or its port was closed)")
    elif ending == endings.DEVICE_STOPPED:
        reason = fault_text(int(loop.state.fault))
        error = DeviceError(f"{name}: the device stopped after {ticks} ticks: {reason}; its force is zero")
    elif ending == endings.NOT_FINITE:
        error = GuardError(
            f"the scene's force was not a finite number at tick {ticks}; the force was set to zero. The scene "
            "has grown without bounds, or a stiffness or a damping is beyond what floating point holds at this rate: "
            "`hapsim check` tells what is stable"
        )
    elif ending == endings.WRONG_RATE:
        error = GuardError(
            f"{name}: the device samples at {loop.record.watch.rate_hz:.4g} Hz, where it declares {trace.rate:g} Hz; "
            f"after {ticks} ticks the force was set to zero. At another rate than the scene's no stiffness and no "
            "damping is what it says: set the device's timer right"
        )
    else:
        return None
    error.trace = trace
    return error
