"""A session: one scene on one device, from opening its port to closing it. Read `Session` from top to bottom.

`__init__` opens the device and assembles the loop; `begin` arms the device; two threads run the loop and collect its
rows; `_finish` disarms the device, closes the record and returns the error of the run.

Both threads are daemons: the interpreter waits for other threads before it calls the handlers of `atexit`, for ever if
a loop still runs. Compiled code must not run while its memory is freed, so a handler of `atexit`, which runs before
numba's own, stops and joins them.
"""

from __future__ import annotations

import atexit
import contextlib
import math
import sys
import threading
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar

from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.cordis.modules.held_detents import MOST_CHANGES
from hapsim.device.connection import Connection, arm, describe, disarm, frames_rejected_by, has_restarted
from hapsim.device.open_connection import open_connection, place_of_device
from hapsim.errors import HapsimError, RunError, UsageError
from hapsim.holds import HOLDS
from hapsim.loop import endings
from hapsim.loop.buffers import last_bytes
from hapsim.loop.compiled_loop import run_loop
from hapsim.loop.counts import Progress
from hapsim.loop.portable import PortableLoop
from hapsim.loop.realtime import PrivilegeResult, realtime, remove_timer_slack
from hapsim.loop.system import missing_calls
from hapsim.recording.recorder import Recorder
from hapsim.recording.report_file import WireBytes, default_directory, write_report
from hapsim.recording.times import Marker, clock_now
from hapsim.recording.trace import Trace, columns_of
from hapsim.running import outcome
from hapsim.running.assemble_loop import assemble_loop
from hapsim.running.changes import LiveScene
from hapsim.running.compile_ahead import DEVICE_UNITS, compile_ahead
from hapsim.running.lsl import Outlets
from hapsim.running.motors import motors_of, note_end
from hapsim.running.places import PlaceChanges
from hapsim.running.recorded_run import prediction_of
from hapsim.running.requirements import (
    PACING,
    require_compatible,
    require_in_time,
    require_known_zero,
    require_runnable,
    with_sensors,
)
from hapsim.running.sensor_check import SensorCheck
from hapsim.running.session_changes import SessionChanges
from hapsim.running.session_options import RunOptions
from hapsim.running.session_view import Closing
from hapsim.scene import Scene
from hapsim.scene.at_port import same_port
from hapsim.sound.play import Playback, SoundOutput
from hapsim.sound.wav import WavFile
from hapsim.stopping import note_arming, undisturbed

_COLLECT_S = 0.05  # period in which the recorder empties the ring of 65536 rows
_REPORT_S = 0.05  # period of the live line
_LAST_ROWS = 1 << 16  # most rows of the last second
_MOST_HISTORY = 1 << 21  # rows
_open: list[Session] = []
"""Running sessions, and those whose failure was not raised yet."""


def sessions() -> list[Session]:
    """Returns the running sessions of this program."""
    return [session for session in _open.copy() if not session._done.is_set()]


def _ignore(_: object) -> None:
    """Stands in for a callback that was not given."""


class Session(SessionChanges, Closing):
    """A running scene. Made by `start`; every method may be called from any thread.

    It runs until its with-block is left, until `stop` or `close`, or until the program ends. Then the device is
    disarmed, and its port is free again.
    """

    _LOOP_UNITS: ClassVar[tuple[str, ...]] = ("loop",)

    def __init__(self, scene: Scene, options: RunOptions) -> None:
        """Opens the device, compiles and assembles the loop. Nothing is armed."""
        require_runnable(scene, options)
        self._options = options
        self._place = place_of_device(scene, options.transport)
        if self._place == "port":
            port = scene.device.port or ""
            for other in sessions():
                if same_port(other.name) == same_port(port):
                    raise UsageError(
                        f"{port}: a session of this program, which runs {other.scene.path or 'a scene'}, is using the "
                        "port. Call its `close` first (`hapsim.sessions()` returns the sessions that run)"
                    )
        self._in_python = options.portable or options.between is not None or bool(missing_calls())
        self.idle_priority = not options.is_virtual(scene) and not self._in_python
        """True if background work of the loop gets idle priority (hapsim.loop.background)."""
        self._over, self._done = threading.Event(), threading.Event()  # the loop has ended; everything has
        self._ending: int | None = None
        self._failure: BaseException | None = None
        self._trace: Trace | None = None
        self._sent_before = b""  # to the device, until it was armed
        self.markers, self._noted_markers, self.trials, self._clock = [], 0, [], clock_now()
        self._place_changes, self._new_notes = PlaceChanges(), deque(maxlen=MOST_CHANGES)
        self._beginning = threading.Lock()
        self.grants: list[PrivilegeResult] = []
        """Results of the real-time set-up: each privilege granted or denied."""
        with contextlib.ExitStack() as stack:
            self._connection = self._open_device(scene, stack)
            scene = with_sensors(scene, options.also_sense, self._description)
            self._loop = assemble_loop(scene, self._connection, self.motors.description, options)
            self._loop.unknown_motor = self.motors.warning
            require_in_time(self._loop.rendered_scene, self._loop.is_virtual)
            self._live = LiveScene(scene, self._loop, self._over.is_set, self.idle_priority, options.unstable)
            self._compile_loop()  # before arming: from then on the loop must answer at once
            kept = max(options.history_s * scene.rate, min(scene.rate, _LAST_ROWS))
            kept = min(math.ceil(kept), _MOST_HISTORY)
            self._recorder = Recorder(self._loop.ring, options.keep, kept, self._take_notes)
            if "acceleration" in scene.sensed and HOLDS[scene.device.hold].keeps_last_force:
                self._loop.sensor_check = SensorCheck(scene.rate, self._description)
                self._recorder.on_rows = self._loop.sensor_check.add
            self._to_file = threading.Lock()
            stack.callback(self._finish_record)
            if options.record is not None:
                self._recorder.file = self._begin_record(Path(options.record))
            if options.sound or options.sound_file is not None:
                self._open_sound(scene, stack)
            self._open_lsl(scene, stack)
            self._resources = stack.pop_all()
        self._thread = threading.Thread(target=self._run_loop, name="haptic loop", daemon=True)
        self._reader = threading.Thread(target=self._collect_and_finish, name="telemetry", daemon=True)

    def stop(self) -> None:
        """Ends the run cleanly; returns at once."""
        self._loop.control.stop = 1

    def wait(self, timeout: float | None = None) -> bool:
        """Waits for at most `timeout` seconds. Returns whether the run has ended and its device is disarmed."""
        return self._done.wait(timeout)

    @property
    def trace(self) -> Trace:
        """Trace of the session once it has ended. Raises UsageError before."""
        if self._trace is None:
            raise UsageError(
                "the trace exists once the run is over: leave the with-block of `start` first, or call `close`"
            )
        return self._trace

    # Opening

    def _compile_loop(self) -> None:
        self._body: Callable[[Any], int] = run_loop
        if self._in_python:
            self._body = PortableLoop(self._loop.record, self._loop.inbox, self._connection.transport).run
        else:
            compile_for(run_loop, self._loop.record)

    def _open_device(self, scene: Scene, stack: contextlib.ExitStack) -> Connection:
        """Opens the device and reads its description. Compiles loop and mock: the mock before it must answer, the loop
        for a port only after that is open."""
        options = self._options
        report = options.on_progress or _ignore
        counted = Counted(lambda name, share: report(Progress("compiling", name, share=share)))
        stack.enter_context(on_compilation(counted.add))
        loop = () if self._in_python else self._LOOP_UNITS
        units = (*loop, *DEVICE_UNITS[self._place])
        if self._place != "port":
            compile_ahead(units, counted)
        opening = open_connection(
            scene, options.transport, portable=options.portable, realtime=options.realtime, between=options.between
        )
        connection = stack.enter_context(opening)
        if self._place == "port" and loop:
            compile_ahead(units, counted)
        self._description = describe(connection)
        require_compatible(scene, connection.name, self._description)
        self.motors = motors_of(scene, connection, self._description)
        """The motors of the device, and what is known of them."""
        connection.known_motors = self.motors.known
        self.restarted = options.resumes and connection.mock is None and has_restarted(connection)
        """True if the device has powered up since the last session, so that its position 0 has changed."""
        if self.restarted:
            require_known_zero(scene, connection.name)
        return connection

    def _open_sound(self, scene: Scene, stack: contextlib.ExitStack) -> None:
        options, ring, warn = self._options, self._loop.sound, self._options.on_warning or _ignore
        assert ring is not None
        self._loop.sound_output = output = SoundOutput(ring)
        stack.callback(self._finish_sound, output)
        if options.sound_file is not None:
            output.file = WavFile(Path(options.sound_file), len(scene.sound), round(scene.step_rate), warn)
        if options.sound:
            try:
                output.playback = Playback(
                    ring,
                    scene.step_rate,
                    burst=scene.substeps,
                    device=options.sound_device,
                    latency_s=options.latency_s,
                    volume_db=options.volume_db,
                    on_warning=warn,
                )
                output.playback.start()
            except UsageError as error:
                if not options.resumes:
                    raise
                warn(f"{error}. The scene continues without sound")

    def _open_lsl(self, scene: Scene, stack: contextlib.ExitStack) -> None:
        options = self._options
        if options.lsl is not None:
            self._lsl = Outlets(options.lsl, scene, self.name, self.stream(), options.on_warning or _ignore)
            stack.callback(self._lsl.send_samples)

    # Running

    def begin(self) -> None:
        """Arms the device and starts the loop. If this fails, everything is released."""
        begin_together([self], self._thread, self._options.on_arming, self, self._end)

    def _warn_of_motors(self) -> None:
        if self.motors.warning:
            (self._options.on_warning or _ignore)(self.motors.warning)

    def _request_privileges(self) -> None:
        if self._options.realtime:
            self.grants = self._resources.enter_context(realtime(self._thread.native_id or 0))

    def _arm(self) -> None:
        loop = self._loop
        arm(
            self._connection,
            self._description,
            PACING[self.scene.device.clock],
            loop.watchdog_samples,
            loop.wire.parts,
        )
        self._sent_before = self._connection.take_written()
        self._reader.start()

    def _run_loop(self) -> None:
        remove_timer_slack()
        try:
            ending = self._body(self._loop.record)
            while ending == endings.RING_FULL:
                self._make_room()
                ending = self._body(self._loop.record)
            self._ending = ending
        finally:
            self._loop_is_over()

    def _make_room(self) -> None:
        self._publish_news()
        self._recorder.collect()
        self._collect_sound()

    def _loop_is_over(self) -> None:
        if self._loop.sound_output is not None:
            self._loop.sound_output.fade()
        self._over.set()

    def _collect_sound(self) -> None:
        if self._loop.sound_output is not None:
            self._loop.sound_output.collect()

    def _collect_and_finish(self) -> None:
        """Empties the ring while the loop runs, then finishes in this thread, where no Ctrl-C interrupts it."""
        try:
            try:
                while not self._over.wait(_COLLECT_S):
                    self._publish_lease_ends()
                    if not self._loop.record.ring.waits:
                        self._publish_news()
                    if not self._loop.record.ring.waits or self._recorder.file is not None:
                        self._recorder.collect()
                    self._collect_sound()
                    if self._lsl is not None:
                        self._lsl.send_samples()
            finally:
                self._failure = self._finish()
        except BaseException as error:  # `_end` returns it to the waiting thread
            self._failure = error
        if self._failure is None and self in _open:  # not if another device could not be opened
            _open.remove(self)
        self._done.set()

    # Ending

    def _end(self) -> BaseException | None:
        """Ends the run and waits until everything is released. Returns its error, if that was not raised yet."""
        self.stop()
        if self._thread.ident is None:
            self._over.set()
        if self._reader.ident is None:  # the device was not armed
            self._collect_and_finish()
        while not self._done.wait(_COLLECT_S):  # in slices: Windows handles a second Ctrl-C between them
            pass
        failure, self._failure = self._failure, None
        if failure is not None:
            _open.remove(self)
        return failure

    def _finish(self) -> RunError | None:
        """Disarms the device and releases everything. Returns the error of a failed run, else None."""
        with self._resources:
            ending = self._end_and_disarm()
        if not self._sent_before:
            return None  # never armed: `begin` raises why
        if self._place == "port":
            note_end(self._loop.record, self.scene, self.name, ending)
        failure = outcome.failure_of(self.label, self.scene, self._loop, self.trace, ending)
        if failure is not None:
            failure = self._with_report(failure)
        sound = self._loop.sound_output
        failure = outcome.file_failure(failure, self.label, None if sound is None else sound.file, self.trace)
        return outcome.file_failure(failure, self.label, self._recorder.file, self.trace)

    def _end_and_disarm(self) -> int:
        """Ends the loop, disarms the device and makes the trace. Returns the code that ended the loop."""
        has_begun = self._thread.ident is not None
        self.stop()
        try:
            if has_begun:
                self._thread.join()
                self._publish_news()
                self._publish_lease_ends()
            self._recorder.collect()
            if self._ending is None and has_begun:
                raise HapsimError("the compiled loop ended with an exception, which is a defect of hapsim")
            ending = endings.STOPPED if self._ending is None else self._ending
            trace = outcome.trace_of(self.scene, self._loop, self._recorder, ending)
        finally:
            # The loop has usually disarmed already. This covers other ways out, and reads the device's confirmation.
            released = disarm(self._connection, self._loop.wire)
        rejected = frames_rejected_by(self._connection) if released else None
        is_released = released or bool(trace.report.released)
        report = replace(trace.report, released=is_released, rejected_by_device=rejected)
        markers = tuple(Marker(one.sample, one.sentence, one.at) for one in self.markers)
        self._trace = replace(trace, report=report, clock=self._clock, markers=markers, trials=tuple(self.trials))
        return ending

    def _finish_record(self) -> None:
        with self._to_file:
            file = self._recorder.file
        if file is None:
            return
        scene, of = self._recorded_scene, self._description
        notes = [{"prediction": prediction_of(scene, of)}] if file.path.suffix == ".trace" else []
        trace = self._trace or outcome.trace_of(self.scene, self._loop, self._recorder, endings.STOPPED)
        self._trace = replace(trace, report=file.finish(trace.report, trace.statistics, notes))

    def _finish_sound(self, output: SoundOutput) -> None:
        output.close()
        if self._trace is not None:
            self._trace = replace(self._trace, report=replace(self._trace.report, **output.counts()))

    def _with_report(self, failure: RunError) -> RunError:
        """Writes the report file of a failed run. Returns the failure with its path, or with the reason for none."""
        directory = self._options.reports
        if directory is None and self._place != "port":
            return failure
        io, inbox = self._loop.record.io, self._loop.inbox
        wire = WireBytes(
            from_device=last_bytes(inbox.last, inbox.bytes),
            to_device=self._sent_before + last_bytes(io.sent, io.outbox) + self._connection.take_written(),
        )
        rows = self._recorder.last_rows(min(math.ceil(self.scene.rate), _LAST_ROWS))
        last = replace(self.trace, **columns_of(rows), sensed={})
        where = ""
        try:
            directory = default_directory() if directory is None else Path(directory)
            where = f" in {directory}"
            path = write_report(directory, self.name, failure, last, self.scene, self._description, wire)
        except Exception as error:  # even a defect must not hide what ended the run
            why = getattr(error, "strerror", None) or error
            return outcome.with_sentence(failure, f". No report of it could be written{where}: {why}")
        return outcome.with_sentence(
            failure, f". The last frames and the last second are in {path} (`hapsim frames` reads it)"
        )


def begin_together(
    sessions: Sequence[Session],
    loop: threading.Thread,
    on_arming: Callable[[Any], None] | None,
    armed: Any,
    end: Callable[[], object],
) -> None:
    """Arms the devices of these sessions, which are assembled, and lets their loop run. `loop`: its thread. `armed`:
    passed to `on_arming` just before. `end`: releases everything, if anything fails."""
    for one in sessions:
        one._loop.control.go = 0  # the thread of the loop waits for it
        _open.append(one)
    try:
        loop.start()
        for one in sessions:
            one._warn_of_motors()
        (on_arming or _ignore)(armed)
        sessions[0]._request_privileges()
        note_arming()
        for one in sessions:
            one._arm()
        for one in sessions:
            one._loop.control.go = 1
    except BaseException:
        end()
        raise


def wait_and_report(session: Session, report: Callable[[Progress], None]) -> None:
    """Waits until the session has ended; meanwhile calls `report` with its progress."""
    while not session.wait(_REPORT_S):
        report(session.progress())
    report(session.progress())


@atexit.register
def _end_with_the_program() -> None:
    """Ends running sessions, and prints the error of each session that was not closed."""
    if not _open:
        return
    with undisturbed():
        for session in _open.copy():
            session.stop()
        for session in _open.copy():
            failure = session._end()
            session._reader.join()
            if failure is not None:
                print(f"hapsim: {failure}", file=sys.stderr)
