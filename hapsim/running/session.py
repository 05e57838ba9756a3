"""A scene while it runs: watched, changed, stopped; and stopped with the program that started it.

The interpreter waits for threads that are no daemons before it calls the handlers of `atexit`: it would wait forever
for a loop that nobody stops. It does not wait for daemons, and compiled code must not run while its memory is freed. So
the threads are daemons, and a handler of `atexit`, which is called before numba's own, stops and joins them.
"""

from __future__ import annotations

import atexit
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any, Self

from hapsim.errors import HapsimError, UsageError
from hapsim.loop import endings
from hapsim.loop.realtime import PrivilegeResult
from hapsim.loop.realtime.scheduling import no_timer_slack
from hapsim.progress import Progress
from hapsim.recording.recorder import Recorder
from hapsim.recording.trace import Statistics, Trace
from hapsim.running.assemble import Loop
from hapsim.running.changes import OVER, LiveScene
from hapsim.running.report import progress_of, statistics_of
from hapsim.scene import Scene
from hapsim.stopping import undisturbed

_COLLECT_S = 0.05  # how often the recorder empties the ring, which holds 65536 rows
_SIZING = threading.Lock()
_STACK_BYTES = 1 << 20  # of the loop's thread: little is needed, and all of it is locked in memory
_open: list[Session] = []
"""Those that run, and those whose failure nobody was told yet."""


def sessions() -> list[Session]:
    """Returns the sessions of this program that run."""
    return [session for session in _open.copy() if not session._done.is_set()]


class Session:
    """A running scene. Made by `start`; every method may be called from any thread.

    It runs until its with-block is left, until `stop` or `close`, or until the program ends. Then the device is
    disarmed, and its port is free again.
    """

    def __init__(
        self,
        scene: Scene,
        name: str,
        loop: Loop,
        body: Callable[[Any], int],
        recorder: Recorder,
        gives_way: bool,
        unstable: bool | None = None,
    ) -> None:
        self._loop, self._body, self._recorder = loop, body, recorder
        self.name = name
        """What its device is called: the port."""
        self._over, self._done = threading.Event(), threading.Event()  # the loop; all that comes after it, too
        self.gives_way = gives_way
        """Whether work beside the loop gives way to it (hapsim.loop.realtime.giving_way)."""
        self._live = LiveScene(scene, loop, self._over.is_set, gives_way, unstable)
        self._ending: int | None = None
        self._thread = threading.Thread(target=self._work, name="haptic loop", daemon=True)
        self._reader = threading.Thread(target=self._read_and_finish, name="telemetry", daemon=True)
        self._failure: BaseException | None = None
        self._trace: Trace | None = None
        self.grants: list[PrivilegeResult] = []
        """What the real-time set-up asked of the system, and what of it was granted."""
        self.restarted = False
        """Whether the device, which ran before, has powered up since: its position 0 is another."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        failure = self._leave()
        if failure is not None and kind is None:
            raise failure

    def __repr__(self) -> str:
        return f"<Session: {self.scene.path or 'a scene'} on {self.name}, {'over' if self._over.is_set() else 'runs'}>"

    @property
    def scene(self) -> Scene:
        """The scene as it is now, with every change that was made."""
        return self._live.scene

    def set(self, changes: Mapping[str, Mapping[str, float]], over: float = 0.02) -> None:
        """Changes parameters between two samples, all or nothing: `{"touch": {"stiffness": 500.0, "damping": 2.0},
        "wall": {"position": 0.01}}`, in the scene's names and units.

        They are led there within `over` seconds (0: at once), no value by more than 1.5/N of its way in one of the N
        samples. A set that comes during another's ramp retargets it: all values arrive when its own do. Where the
        energy is judged, one that would give the hand too much is slowed, with all its values in step. UsageError
        where a name, a key or a value is wrong, or what is asked for cannot change while the scene runs, or with
        `start(unstable=False)` the scene is predicted unstable by it; nothing has changed then.
        """
        self._require_running()
        self._live.set(changes, over)

    def adopt(self, scene: Scene, over: float = 0.02) -> None:
        """Changes to `scene`. Where it differs in nothing but live parameters, as `set` does; otherwise its modules are
        compiled beside the running loop, which then moves both scenes for `over` seconds, and leads the force in the
        hand from the one's to the other's: in one of the N samples by no more than 1.5/N of what is between them.

        What both have under one name and of one type goes on from where it is: points with their velocities, live
        parameters, what links remember. UsageError, and nothing is changed, where the rate, the device or the mock
        differ, where the device has too few channels or was not asked for the velocities that are needed, where the
        scene is predicted unstable (but with `start(unstable=True)`), or has too much for its scheme.
        """
        self._require_running()
        self._live.adopt(scene, over)

    def progress(self) -> Progress:
        """How it is doing."""
        return progress_of(self._loop)

    def statistics(self) -> Statistics:
        """Lateness, exchange time and age of the force, of every tick so far."""
        return statistics_of(self._loop)

    def stop(self) -> None:
        """Ends it in good order; returns at once."""
        self._loop.control.stop = 1

    def wait(self, timeout: float | None = None) -> bool:
        """Returns whether it has ended, and its device is disarmed; waits for that for at most `timeout` seconds."""
        return self._done.wait(timeout)

    def close(self) -> None:
        """Ends it in good order, and returns when its device is disarmed, its record is whole and its port is free.

        Raises what ended the run before, as `start` describes, the first time that it is called.
        """
        failure = self._leave()
        if failure is not None:
            raise failure

    @property
    def trace(self) -> Trace:
        """What happened, once the session has ended."""
        if self._trace is None:
            raise UsageError(
                "the trace is there once the run is over: leave the with-block of `start` first, or call `close`"
            )
        return self._trace

    def _require_running(self) -> None:
        if self._over.is_set():
            raise UsageError(OVER)

    def _work(self) -> None:
        no_timer_slack()
        try:
            ending = self._body(self._loop.record)
            while ending == endings.RING_FULL:
                self._recorder.collect()
                ending = self._body(self._loop.record)
            self._ending = ending
        finally:
            self._over.set()

    def _read_and_finish(self) -> None:
        """Empties the ring while the loop runs. Then it does all that is left to do, in this thread, where no Ctrl-C of
        an impatient user interrupts it."""
        try:
            try:
                while not self._over.wait(_COLLECT_S):
                    if not self._loop.record.ring.waits or self._recorder.file is not None:
                        self._recorder.collect()
            finally:
                self._failure = self._finish()
        except BaseException as error:  # raised where somebody waits for the end
            self._failure = error
        if self._failure is None:
            _open.remove(self)
        self._done.set()

    def _begin(self, finish: Callable[[], BaseException | None]) -> None:
        """Starts the threads; the loop waits for `_go`. `finish`: releases all that was opened once the loop has ended,
        and returns the error of the run."""
        self._finish = finish
        self._loop.control.go = 0
        _open.append(self)
        with _SIZING:  # the size is the whole process's: another session must not take ours for what it was before
            stack = threading.stack_size(_STACK_BYTES)
            try:
                self._thread.start()
            finally:
                threading.stack_size(stack)

    def _go(self) -> None:
        """The device is armed: the loop begins."""
        self._reader.start()
        self._loop.control.go = 1

    def _end(self) -> int:
        """The loop's ending, once its thread has ended."""
        self.stop()
        if self._thread.ident is not None:
            self._thread.join()
        self._recorder.collect()
        if self._ending is None and self._thread.ident is not None:
            raise HapsimError("the compiled loop ended with an exception, which is a defect of hapsim")
        return endings.STOPPED if self._ending is None else self._ending

    def _leave(self) -> BaseException | None:
        """Ends it, and waits until everything is released; what nobody was told of how it ended."""
        self.stop()
        if self._thread.ident is None:
            self._over.set()
        if self._reader.ident is None:  # the device was not armed
            self._read_and_finish()
        self._done.wait()
        failure, self._failure = self._failure, None
        if failure is not None:
            _open.remove(self)
        return failure

    @property
    def _thread_id(self) -> int:
        return self._thread.native_id or 0


@atexit.register
def _end_with_the_program() -> None:
    """Ends what runs, and prints what ended a session that nobody closed."""
    if not _open:
        return
    with undisturbed():
        for session in _open.copy():
            session.stop()
        for session in _open.copy():
            failure = session._leave()
            session._reader.join()
            if failure is not None:
                print(f"hapsim: {failure}", file=sys.stderr)
