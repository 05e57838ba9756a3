"""Running a scene on the mock in memory, in virtual time and in the calling thread: for thousands of short runs."""

from __future__ import annotations

from dataclasses import replace

from firmware_protocol import schema
from firmware_protocol.description import from_registers
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import Counted
from hapsim.device.connection import Connection
from hapsim.device.conversation import arm
from hapsim.device.mock.assemble import assemble_mock
from hapsim.device.mock.loopback import loopback_transport
from hapsim.errors import UsageError
from hapsim.loop import endings
from hapsim.loop.run import run_loop
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Trace
from hapsim.running import outcome
from hapsim.running.assemble import assemble_loop
from hapsim.running.compile_ahead import DEVICE_UNITS, compile_ahead
from hapsim.running.options import Excitation, PeriodicExcitation, RunOptions
from hapsim.running.requirements import PACING, require_compatible, require_in_time, require_runnable
from hapsim.scene import Scene

_NAME = "mock in memory"


def run_in_memory(scene: Scene, *, duration: float, excitation: Excitation | PeriodicExcitation | None = None) -> Trace:
    """Runs `scene` for `duration` seconds and returns its trace: the one of `run`, in a fifth of its time, since no
    session is opened and nothing is asked over the wire that is known here. Nothing stops it early.

    Raises what `run` raises, and UsageError where the scene does not run in virtual time."""
    if scene.device.clock != "lockstep" or scene.device.port is not None:
        raise UsageError(f"device: found clock: {scene.device.clock}, expected lockstep, and no port")
    options = RunOptions(duration=duration, excitation=excitation)
    require_runnable(scene, options)
    compile_ahead(("loop", *DEVICE_UNITS["loopback"]), Counted(lambda *_: None))
    mock = assemble_mock(scene)
    connection = Connection(loopback_transport(mock), _NAME, close=lambda: None, mock=mock)
    description = from_registers(mock.registers)
    require_compatible(scene, _NAME, description)
    loop = assemble_loop(scene, connection, description, options)
    require_in_time(loop.rendered_scene)
    compile_for(run_loop, loop.record)
    recorder = Recorder(loop.ring, keep=True)
    arm(connection, description, PACING["lockstep"], loop.watchdog_samples, bool(scene.sensed_links))
    ending = endings.RING_FULL
    while ending == endings.RING_FULL:
        ending = run_loop(loop.record)
        recorder.collect()
    trace = outcome.trace_of(scene, loop, recorder, ending)
    released = int(mock.board.state) in (schema.IDLE, schema.LATCHED)
    trace = replace(trace, report=replace(trace.report, released=released))
    if failure := outcome.failure_of(_NAME, scene, loop, trace, ending):
        raise failure
    return trace
