"""From a scene to a running session, and out of it again: every way out tells the device to release its force, and
whether the device confirmed it is part of the report."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, TypedDict

from firmware_protocol.description import Description
from hapsim.compiling.entries import compile_for
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.connection import Connection
from hapsim.device.conversation import arm, describe, disarm, frames_rejected_by, has_restarted
from hapsim.device.open_connection import (
    Between,
    Place,
    TransportKind,
    open_connection,
    place_of_device,
    require_possible_here,
)
from hapsim.errors import RunError, UsageError
from hapsim.loop.portable import PortableLoop
from hapsim.loop.realtime import realtime as with_realtime
from hapsim.loop.run import run_loop
from hapsim.loop.system import missing_calls, require_linux
from hapsim.prediction import surely_shaken_by
from hapsim.prediction.force_bounds import refused_travel
from hapsim.progress import Progress
from hapsim.recording.recorder import Recorder
from hapsim.recording.report_file import default_directory
from hapsim.recording.trace import require_writable_as_trace
from hapsim.running.assemble import Loop, assemble_loop
from hapsim.running.compatibility import PACING, require_compatible, require_known_zero
from hapsim.running.compile_ahead import compile_ahead
from hapsim.running.excitation import Excitation, PeriodicExcitation
from hapsim.running.prepare import MOCK_UNITS
from hapsim.running.recorded import recorded, with_record, with_report
from hapsim.running.report import failure_of, trace_of, with_farewell
from hapsim.running.session import Session, sessions
from hapsim.running.stability import require_startable
from hapsim.scene import Scene
from hapsim.stopping import note_arming

_MOST_TICKS = 2.0**62
_LAST_ROWS = 1 << 16  # of the last second, at most


class StartOptions(TypedDict, total=False):
    """What `start` takes beside the scene, for those who pass it on."""

    duration: float | None
    transport: TransportKind
    excitation: Excitation | PeriodicExcitation | None
    keep: bool
    record: str | Path | None
    reports: str | Path | None
    realtime: bool
    portable: bool
    between: Between | None
    unstable: bool | None
    judges_energy: bool
    judges_sign: bool
    on_progress: Callable[[Progress], None] | None
    on_warning: Callable[[str], None] | None


def start(
    scene: Scene,
    *,
    duration: float | None = None,
    transport: TransportKind = "auto",
    excitation: Excitation | PeriodicExcitation | None = None,
    keep: bool = True,
    record: str | Path | None = None,
    reports: str | Path | None = None,
    realtime: bool = False,
    portable: bool = False,
    between: Between | None = None,
    unstable: bool | None = None,
    judges_energy: bool = False,
    judges_sign: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    on_warning: Callable[[str], None] | None = None,
    on_arming: Callable[[Session], None] | None = None,
    resumes: bool = False,
) -> Session:
    """Starts `scene` and returns its session. It runs for `duration` seconds (None: without an end), until it is
    stopped or closed, until its with-block is left, if it has one, and no longer than the program.

    * `transport`: where the device is ("auto": the scene's port, else the mock that fits the clock).
    * `keep`: False for a trace without rows, for runs without an end.
    * `record`: a .trace, .npz or .csv that is written while it runs, in memory that does not grow; what was written
      before a crash is read by `load_trace`.
    * `reports`: the directory for the report file of a run that a guard, a fault of the device or a lost device ends;
      None: a default one where the device is on a port, no file for the mock in this process.
    * `realtime`: asks the system for what makes a loop steady, see hapsim.loop.realtime; `Session.grants` says what was
      granted.
    * `portable`: the loop in plain Python over pyserial; off Linux that loop runs with the mock in memory too.
    * `between`: what loop and device speak through, made of the transport to the device; the loop is then the one in
      Python.
    * `unstable`: whether a scene that is surely predicted unstable may run: False refuses it, at the start and as a
      change (`Session.set`, `Session.adopt`), True takes it, and the energy guard looks closer
      (hapsim/STABILITY.md); None starts and sets it, and `Session.adopt` refuses what is more unstable than what runs.
    * `judges_energy`: a scene that gives the hand energy is stopped before the mock too, as by `hapsim run`; behind a
      port, or where it names `energy_limit`, it always is.
    * `judges_sign`: a motor that pushes the wrong way is stopped before the mock too; behind a port it always is.
    * `on_progress` hears of the compilation; `on_warning` once, in a sentence and in another thread, of a record that
      cannot be written any more; `on_arming` gets the session just before the device is armed: a `stop` from then on
      ends the run in good order;
    * `resumes`: the device took forces before: `Session.restarted` says whether it powered up since, with another
      zero, and where the scene counts from that the device is not armed.

    Raises SceneError and UsageError for what cannot be run, and DeviceError where port or device fail. What ended the
    run is raised when the with-block is left, or by `Session.close`: DeviceError, GuardError where a guard stopped the
    force, RecordError where the run went as asked and its record did not. They carry what was recorded as their
    attribute `trace`. Where a session is not closed, the sentence is printed when the program ends.
    """
    _require_sound(scene, duration, realtime, unstable)
    if record is not None:
        require_writable_as_trace(Path(record))
    if unstable is False:
        require_startable(scene)
    place = place_of_device(scene, transport, portable=portable)
    if place == "port":
        _require_no_session_on(scene.device.port or "")
    tell = on_progress or (lambda _: None)
    counted = Counted(lambda name, share: tell(Progress("compiling", name, share=share)))
    in_python = portable or between is not None or bool(missing_calls())
    with contextlib.ExitStack() as stack:
        stack.enter_context(on_compilation(counted.add))
        opened = stack.enter_context(_open(scene, transport, portable, in_python, realtime, between, counted))
        description = describe(opened)
        require_compatible(scene, opened.name, description)
        restarted = resumes and has_restarted(opened)
        if restarted:
            require_known_zero(scene, opened.name)
        loop = assemble_loop(scene, opened, description, excitation, duration, judges_energy, judges_sign)
        if unstable and loop.energy_guard is not None:
            loop.energy_guard.follow(unstable=surely_shaken_by(scene) is not None)
        # Everything is compiled now: the device is armed only when the loop can answer at once.
        gives_way = scene.device.clock != "lockstep" and not in_python
        recorder = Recorder(loop.ring, keep, min(math.ceil(scene.rate), _LAST_ROWS))
        body = _ready_body(opened, loop, in_python)
        session = Session(scene, opened.name, loop, body, recorder, gives_way, unstable)
        session.restarted = restarted
        stack.enter_context(recorded(session, record, on_warning))
        held, spoken = stack.pop_all(), b""

    def finish() -> RunError | None:
        with held:
            ending = _released(session, scene, opened, loop, recorder)
        if not spoken:
            return None  # never armed: whoever starts it is told why
        failure = failure_of(opened.name, scene, loop, session.trace, ending)
        failure = with_report(failure, lambda: _report_directory(reports, place), opened, session, description, spoken)
        return with_record(failure, opened.name, session)

    try:
        session._begin(finish)
        if on_arming is not None:
            on_arming(session)
        if realtime:
            held.enter_context(_real_time(session))
        note_arming()
        _arm(scene, opened, description, loop)
        spoken = opened.take_written()
        session._go()
    except BaseException:
        session._leave()
        raise
    return session


def _released(session: Session, scene: Scene, opened: Connection, loop: Loop, recorder: Recorder) -> int:
    """How the loop ended, once the device is disarmed; the session has its trace then."""
    try:
        ending = session._end()
        session._trace = trace_of(scene, loop, recorder, ending)
    finally:
        # The loop has disarmed already; this is for every way out that did not get so far, and to know.
        released = disarm(opened, loop.wire)
    session._trace = with_farewell(session.trace, released, frames_rejected_by(opened) if released else None)
    return ending


def _require_no_session_on(port: str) -> None:
    for session in sessions():
        if os.path.realpath(session.name) == os.path.realpath(port):
            raise UsageError(
                f"{port}: a session of this program, which runs {session.scene.path or 'a scene'}, is using the port. "
                "Call its `close` first (`hapsim.sessions()` returns the sessions that run)"
            )


def _report_directory(asked: str | Path | None, place: Place) -> Path | None:
    if asked is not None:
        return Path(asked)
    return default_directory() if place == "port" else None


def _require_sound(scene: Scene, duration: float | None, realtime: bool, unstable: bool | None) -> None:
    if not 1e-3 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which no clock keeps (1e-3 to 1e9 Hz)")
    if duration is not None and not 0 < duration * scene.rate < _MOST_TICKS:
        raise UsageError(f"duration: found {duration}, expected a finite number of seconds above 0")
    if not unstable and (why := refused_travel(scene)):
        raise UsageError(why)
    if realtime:
        require_linux("--realtime", "leave it out")


@contextlib.contextmanager
def _open(
    scene: Scene,
    transport: TransportKind,
    portable: bool,
    in_python: bool,
    realtime: bool,
    between: Between | None,
    counted: Counted,
) -> Iterator[Connection]:
    """The connection; what loop and mock need is compiled, the mock's part before it has to answer."""
    place = place_of_device(scene, transport, portable=portable)
    require_possible_here(place, portable=portable or between is not None)
    loop = () if in_python else ("loop",)
    if place != "port":
        compile_ahead((*loop, *MOCK_UNITS[place]), counted)
    with open_connection(scene, transport, portable=portable, realtime=realtime, between=between) as opened:
        if loop:
            compile_ahead((*loop, "port"), counted)
        yield opened


def _arm(scene: Scene, opened: Connection, description: Description, loop: Loop) -> None:
    arm(opened, description, PACING[scene.device.clock], loop.watchdog_samples, bool(scene.sensed_links))


def _ready_body(connection: Connection, loop: Loop, in_python: bool) -> Callable[[Any], int]:
    """The loop, compiled: nothing is left to be done when the device is armed."""
    if in_python:
        return PortableLoop(loop.record, loop.inbox, connection.transport).run
    compile_for(run_loop, loop.record)
    return run_loop


@contextlib.contextmanager
def _real_time(session: Session) -> Iterator[None]:
    with with_realtime(session._thread_id) as grants:
        session.grants = grants
        yield
