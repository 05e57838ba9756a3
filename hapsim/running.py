"""Running a scene: open the line, describe, arm, loop, disarm; and every way out of it leaves the force at zero."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from firmware_protocol.frames import armed_format
from hapsim.compiled import compile_for, on_compilation
from hapsim.cordis.program import compile_scene
from hapsim.device.conversation import arm, describe, disarm, fault_text
from hapsim.device.line import Line
from hapsim.device.open_line import LineKind, open_line
from hapsim.errors import DeviceError, GuardError, HapsimError, RunError, UsageError
from hapsim.loop import exchange
from hapsim.loop.exchange import CONTROL, DESK, STATE, Loop
from hapsim.loop.paced_by_device import run_paced_by_device
from hapsim.loop.paced_by_host import run_paced_by_host
from hapsim.loop.recorder import Recorder
from hapsim.loop.ring import new_ring
from hapsim.loop.trace import Report, Trace
from hapsim.progress import Progress
from hapsim.scene import Scene

_RING_ROWS = 1 << 16
_MOST_TICKS = 2.0**62
_LOOK_S = 0.05  # how often the recorder and the live line look at the loop
_PACING = {
    "device": schema.PACED_BY_DEVICE,
    "host": schema.PACED_BY_HOST,
    "lockstep": schema.LOCKSTEP,
}
_ENDINGS = {
    exchange.DONE: "done",
    exchange.STOPPED: "stopped",
    exchange.SILENT: "device silent",
    exchange.GONE: "device gone",
    exchange.NOT_FINITE: "force not finite",
    exchange.DEVICE_STOPPED: "device stopped",
}


@dataclass(frozen=True)
class Excitation:
    """Pushes on one channel, for `ticks` samples every `every` samples from sample `start` on, to one side and to the
    other in turn: from `force` in N down to half of it, each different. They pass the guards like any force.
    `first`: one at the very beginning too."""

    channel: int
    force: float
    ticks: int
    every: int
    start: int
    first: bool


def run(
    scene: Scene,
    *,
    duration: float | None = None,
    line: LineKind = "auto",
    excitation: Excitation | None = None,
    keep: bool = True,
    on_progress: Callable[[Progress], None] | None = None,
    stop_on_signals: bool = False,
) -> Trace:
    """Runs `scene` for `duration` seconds (None: until stopped) and returns what happened.

    `line`: where the device is ("auto": the scene's port, else the mock that fits the clock). `keep`: False for a trace
    without rows, for runs without an end. `stop_on_signals`: SIGINT, SIGTERM and SIGHUP end the run in good order
    (main thread only).

    Raises SceneError and UsageError for what cannot be run, DeviceError where port or device fail, GuardError where a
    guard stopped the force; the two last carry what was recorded as their attribute `trace`.
    """
    if not 1e-9 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which no clock keeps (1e-9 to 1e9 Hz)")
    if duration is not None and not 0 < duration * scene.rate < _MOST_TICKS:
        raise UsageError(f"duration: found {duration}, expected a finite number of seconds above 0")
    tell = on_progress or (lambda _: None)
    with on_compilation(lambda name: tell(Progress("compiling", name))), open_line(scene, line) as opened:
        description = describe(opened)
        _require_fit(scene, opened, description)
        loop = _assemble(scene, opened, description, excitation, duration)
        body = run_paced_by_host if scene.device.clock == "host" else run_paced_by_device
        # Everything is compiled now: the device is armed only when the loop can answer at once.
        compile_for(body, loop)
        recorder = Recorder(loop.ring, keep)
        watchdog = _watchdog_samples(scene.rate, description)
        with _signals(loop.control) if stop_on_signals else contextlib.nullcontext():
            try:
                arm(opened, description, _PACING[scene.device.clock], watchdog, bool(scene.sensed_links))
                ending = _run_in_thread(body, loop, recorder, tell)
                trace = _trace(scene, loop, recorder, _ENDINGS[ending])
            finally:
                # The loop let go already; this is for every way out that did not get so far.
                disarm(opened, loop.wire)
    _raise_what_failed(opened.name, ending, loop, trace)
    return trace


def _require_fit(scene: Scene, line: Line, description: Description) -> None:
    """UsageError or DeviceError where scene and device do not go together."""
    if description.channels < scene.channels:
        raise UsageError(
            f"{line.name}: the device has {description.channels} channel(s), the scene uses {scene.channels}"
        )
    scales = (*description.position_scale, *description.force_scale, *description.force_limit, description.rate_hz)
    if not all(np.isfinite(scales)) or min(scales) <= 0:
        raise DeviceError(f"{line.name}: the device declares a rate, scale or limit that is not a number above 0")
    if abs(description.rate_hz / scene.rate - 1.0) > 1e-6:
        raise UsageError(
            f"{line.name}: the device samples at {description.rate_hz:g} Hz, the scene says {scene.rate:g} Hz: "
            f"write rate: {description.rate_hz:g} into the scene, or set the device"
        )
    if not description.paces(_PACING[scene.device.clock]):
        raise UsageError(
            f"{line.name}: the device cannot be run with clock: {scene.device.clock}; try another clock in the scene"
        )
    if scene.sensed_links:
        _require_velocity(scene, line, description)


def _require_velocity(scene: Scene, line: Line, description: Description) -> None:
    links = scene.sensed_links
    if not description.velocity_scale:
        raise UsageError(
            f"{line.name}: the device does not sense velocity, but {', '.join(links)} {'ask' if links[1:] else 'asks'} "
            "for it with damper: sensed; write damper: backward, centred or filtered there, or use a firmware that "
            "reports velocity"
        )
    if not description.senses_velocity or not all(np.isfinite(description.velocity_scale)):
        raise DeviceError(f"{line.name}: the device declares a velocity scale that is not a number above 0")


def _assemble(
    scene: Scene, line: Line, description: Description, excitation: Excitation | None, duration: float | None
) -> Loop:
    """Every array of the loop, allocated once."""
    channels = description.channels
    control, state = np.zeros(1, CONTROL)[0], np.zeros(1, STATE)[0]
    control["ticks"] = -1 if duration is None else max(1, round(duration * scene.rate))
    control["period_ns"] = round(1e9 / scene.rate)
    control["host_is_clock"] = scene.device.clock == "host"
    control["silence_ns"] = round(1e9 * max(0.25, 20.0 / scene.rate))
    control["time_to_live"] = min(max(round(0.02 * scene.rate), 2), schema.MAX_TIME_TO_LIVE_SAMPLES)
    if scene.device.clock == "lockstep":
        control["silence_ns"] = 5_000_000_000  # the mock may live in a process that is only now being compiled
    if excitation is not None:
        control["pulse_channel"] = excitation.channel
        control["pulse_force"] = excitation.force
        control["pulse_ticks"] = excitation.ticks
        control["pulse_every"] = excitation.every
        control["pulse_first"] = excitation.first
        control["pulse_from"] = excitation.start
    return Loop(
        port=line.port,
        inbox=line.inbox,
        decoder=line.decoder,
        wire=armed_format(channels, bool(scene.sensed_links)),
        program=compile_scene(scene),
        ring=new_ring(channels, _RING_ROWS, waits=scene.device.clock == "lockstep"),
        desk=_desk(scene, description),
        control=control,
        state=state,
    )


def _desk(scene: Scene, description: Description) -> Any:
    desk = np.zeros(1, DESK)[0]
    channels = description.channels
    desk["channels"] = channels
    desk["position_scale"][:channels] = description.position_scale
    desk["force_scale"][:channels] = description.force_scale
    if scene.sensed_links:
        desk["velocity_scale"][:channels] = description.velocity_scale
    # In whole counts, so that the rounding of a force at its limit does not go beyond it, nor a count beyond 32 bits.
    scale, limit = np.array(description.force_scale), np.minimum(description.force_limit, scene.device.force_limit)
    with np.errstate(over="ignore"):
        counts = np.minimum(np.floor(limit / scale * (1.0 + 1e-12)), 2.0**31 - 1.0)
    desk["force_limit"][:channels] = counts * scale
    return desk


def _watchdog_samples(rate: float, description: Description) -> int:
    """A tenth of a second of silence of the host, as far as the device lets us."""
    return min(max(round(0.1 * rate), 10), description.max_watchdog_samples)


def _run_in_thread(
    body: Callable[[Loop], int], loop: Loop, recorder: Recorder, tell: Callable[[Progress], None]
) -> int:
    """Runs the compiled loop beside this thread, which keeps the record and hears signals. Why the loop ended."""
    endings: list[int] = []

    def work() -> None:
        ending = body(loop)
        while ending == exchange.RING_FULL:
            recorder.collect()
            ending = body(loop)
        endings.append(ending)

    thread = threading.Thread(target=work, name="haptic loop")
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_LOOK_S)
            if not loop.ring.cursor["waits"]:
                recorder.collect()
            tell(_progress(loop))
    finally:
        loop.control["stop"] = 1
        thread.join()
    recorder.collect()
    if not endings:
        raise HapsimError("the compiled loop ended with an exception, which is a defect of hapsim")
    return endings[0]


def _progress(loop: Loop) -> Progress:
    state, desk = loop.state, loop.desk
    elapsed = (int(state["newest_ns"]) - int(state["first_ns"])) * 1e-9
    ticks = int(state["ticks"])
    return Progress(
        "running",
        elapsed_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        force=tuple((desk["force_counts"] * desk["force_scale"])[: int(desk["channels"])].tolist()),
        age_samples=int(state["age"]),
        late_ticks=int(state["late_ticks"]),
        limited_ticks=int(state["limited_ticks"]),
    )


def _trace(scene: Scene, loop: Loop, recorder: Recorder, ending: str) -> Trace:
    state, virtual = loop.state, scene.device.clock == "lockstep"
    ticks = int(state["ticks"])
    samples = max(ticks - 1, 0)
    elapsed = samples / scene.rate if virtual else (int(state["newest_ns"]) - int(state["first_ns"])) * 1e-9
    decoder = loop.decoder
    report = Report(
        ending=ending,
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=samples / elapsed if elapsed > 0 else 0.0,
        nominal_rate_hz=scene.rate,
        late_ticks=int(state["late_ticks"]),
        lost_frames=int(state["lost_frames"]),
        crc_errors=int(decoder["crc_errors"] + decoder["length_errors"] + decoder["form_errors"]),
        stale_positions=int(state["stale_positions"]),
        limited_ticks=int(state["limited_ticks"]),
        dropped_rows=int(loop.ring.cursor["dropped"]),
        max_age_samples=int(state["max_age"]),
        max_lateness_s=int(state["max_lateness_ns"]) * 1e-9,
        virtual_time=virtual,
    )
    return recorder.trace(
        scene.rate,
        loop.desk["position_scale"][: int(loop.desk["channels"])].copy(),
        loop.desk["force_scale"][: int(loop.desk["channels"])].copy(),
        report,
    )


def _raise_what_failed(name: str, ending: int, loop: Loop, trace: Trace) -> None:
    error: RunError
    ticks = trace.report.ticks
    if ending == exchange.SILENT:
        silence = loop.control["silence_ns"] * 1e-9
        error = DeviceError(f"{name}: the device was silent for {silence:.2g} s after {ticks} ticks; the force is zero")
    elif ending == exchange.GONE:
        error = DeviceError(f"{name}: the device went away after {ticks} ticks (unplugged, or its port was closed)")
    elif ending == exchange.DEVICE_STOPPED:
        reason = fault_text(int(loop.state["fault"]))
        error = DeviceError(f"{name}: the device stopped after {ticks} ticks: {reason}; its force is zero")
    elif ending == exchange.NOT_FINITE:
        error = GuardError(
            f"the scene's force was not a finite number at tick {ticks}; the force was set to zero. A stiffness or a "
            "damping is beyond what floating point holds at this rate: `hapsim check` tells what is stable"
        )
    else:
        return
    error.trace = trace
    raise error


@contextlib.contextmanager
def _signals(control: Any) -> Iterator[None]:
    """While open, signals that mean "stop" end the loop between two ticks."""

    def stop(_signal: int, _frame: object) -> None:
        control["stop"] = 1

    meant = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, stop) for number in meant}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
