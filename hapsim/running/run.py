"""Running a scene to its end: in a session, or without one on the mock in memory."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from firmware_protocol import schema
from firmware_protocol.description import from_registers
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import Counted
from hapsim.device.connection import Connection, arm
from hapsim.errors import UsageError
from hapsim.loop import endings
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.portable import PortableLoop
from hapsim.loop.system import missing_calls
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Trace
from hapsim.running import outcome
from hapsim.running.assemble_loop import assemble_loop
from hapsim.running.compile_ahead import DEVICE_UNITS, compile_ahead
from hapsim.running.requirements import PACING, require_compatible, require_runnable
from hapsim.running.session import Session, wait_and_report
from hapsim.running.session_options import Excitation, PeriodicExcitation, RunOptions
from hapsim.running.start import start
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene
from hapsim.stopping import stopping_on_signals


def run(
    scene: SceneSource,
    *,
    on_start: Callable[[Session], None] | None = None,
    stop_on_signals: bool = False,
    **options: Any,
) -> Trace:
    """Runs `scene`, a Scene or the path of a scene file, until it ends, and returns its trace.

    Ctrl-C (a notebook's "interrupt") while the scene runs disarms the device and returns the trace so far. The `ending`
    of its report is then "interrupted", which a program that runs several scenes in turn should check. Before the
    device is armed, KeyboardInterrupt is raised.

    * `on_start`: called with the session once the scene runs.
    * `stop_on_signals`: SIGINT, SIGTERM and SIGHUP end the run cleanly (main thread only), with the ending "stopped".
    * `options`: as of `start`. `on_progress` is also called while the scene runs.

    Raises what `start` and `Session.close` raise.
    """
    interrupts: list[KeyboardInterrupt] = []
    trace = run_to_end(scene, on_start, stop_on_signals, interrupts.append, **options)
    return replace(trace, report=replace(trace.report, ending="interrupted")) if interrupts else trace


def run_to_end(
    scene: SceneSource,
    on_start: Callable[[Session], None] | None = None,
    stop_on_signals: bool = False,
    on_interrupt: Callable[[KeyboardInterrupt], None] | None = None,
    **options: Any,
) -> Trace:
    """Does what `run` does. A KeyboardInterrupt is passed to `on_interrupt` [default: raised]."""
    if (scene := as_scene(scene)).ports:
        raise UsageError(
            "found a scene with several devices, expected one: use hapsim.start, whose session has `traces`"
        )
    report = options.get("on_progress") or (lambda _: None)
    armed: Session | None = None
    stopped = False

    def stop() -> None:
        """Ends the run; before arming by KeyboardInterrupt."""
        nonlocal stopped
        stopped = True
        if armed is None:
            raise KeyboardInterrupt  # nothing is armed yet
        armed.stop()

    def arming(session: Session) -> None:
        """Lets `stop` end the session from now on."""
        nonlocal armed
        if stopped:  # a callback swallowed the interrupt
            raise KeyboardInterrupt
        armed = session

    with (
        stopping_on_signals(stop) if stop_on_signals else contextlib.nullcontext(),
        start(scene, on_arming=arming, **options) as session,
    ):
        try:
            if on_start is not None:
                on_start(session)
            wait_and_report(session, report)
        except KeyboardInterrupt as interrupt:
            if on_interrupt is None:
                raise
            on_interrupt(interrupt)
    return session.trace


def traces_to_end(scene: Scene, **options: Any) -> dict[str, Trace]:
    """Runs a scene with several devices until it ends, and returns their traces by name. `options`: as of `run`."""
    report, stops = options.pop("on_progress", None), options.pop("stop_on_signals", False)
    session: Any = start(scene, on_progress=report, **options)
    with stopping_on_signals(session.stop) if stops else contextlib.nullcontext(), session:
        while not session.wait(0.05):
            if report is not None:
                report(next(iter(session.progress().values())))
    found: dict[str, Trace] = session.traces
    return found


def run_in_memory(scene: Scene, *, duration: float, excitation: Excitation | PeriodicExcitation | None = None) -> Trace:
    """Runs `scene` for `duration` seconds and returns the same trace as `run` in a fifth of its time: it opens no
    session and requests no description over the wire. Nothing stops it early.

    Raises the errors of `run`, and UsageError if the scene does not run in virtual time."""
    from hapsim.device.mock.assemble_mock import assemble_mock
    from hapsim.device.mock.wire import loopback_transport

    name = "mock in memory"
    if scene.device.clock != "lockstep" or scene.device.port is not None:
        raise UsageError(f"device: found clock: {scene.device.clock}, expected lockstep, and no port")
    options = RunOptions(duration=duration, excitation=excitation)
    require_runnable(scene, options)
    loop_units = () if missing_calls() else ("loop",)
    compile_ahead((*loop_units, *DEVICE_UNITS["loopback"]), Counted(lambda *_: None))
    mock = assemble_mock(scene)
    connection = Connection(loopback_transport(mock), name, close=lambda: None, mock=mock)
    description = from_registers(mock.registers)
    require_compatible(scene, name, description)
    loop = assemble_loop(scene, connection, description, options)
    body: Callable[[Any], int] = run_loop
    if missing_calls():
        body = PortableLoop(loop.record, loop.inbox, connection.transport).run
    else:
        compile_for(run_loop, loop.record)
    recorder = Recorder(loop.ring, keep=True)
    arm(connection, description, PACING["lockstep"], loop.watchdog_samples, loop.wire.parts)
    ending = endings.RING_FULL
    while ending == endings.RING_FULL:
        ending = body(loop.record)
        recorder.collect()
    trace = outcome.trace_of(scene, loop, recorder, ending)
    released = int(mock.board.state) in (schema.IDLE, schema.LATCHED)
    trace = replace(trace, report=replace(trace.report, released=released))
    if failure := outcome.failure_of(name, scene, loop, trace, ending):
        raise failure
    return trace
