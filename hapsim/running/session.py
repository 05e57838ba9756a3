"""A scene while it runs: started, watched, changed, stopped."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from hapsim.compiled import compile_for, on_compilation
from hapsim.device.conversation import arm, describe, disarm
from hapsim.device.line import Line
from hapsim.device.open_line import LineKind, open_line
from hapsim.errors import HapsimError, UsageError
from hapsim.loop import endings
from hapsim.loop.exchange import Loop
from hapsim.loop.paced_by_device import run_paced_by_device
from hapsim.loop.paced_by_host import run_paced_by_host
from hapsim.loop.portable import PortableLoop, PortablePort
from hapsim.loop.recorder import Recorder
from hapsim.loop.trace import Statistics, Trace
from hapsim.progress import Progress
from hapsim.realtime import Grant, realtime
from hapsim.realtime.slack import no_timer_slack
from hapsim.running.assemble import assemble_loop, watchdog_samples
from hapsim.running.changes import LiveParameters
from hapsim.running.excitation import Excitation
from hapsim.running.fit import PACING, require_fit
from hapsim.running.outcome import failure_of, progress_of, statistics_of, trace_of
from hapsim.scene import Scene

_MOST_TICKS = 2.0**62
_COLLECT_S = 0.05  # how often the recorder empties the ring, which holds 65536 rows
_SIZING = threading.Lock()
_STACK_BYTES = 1 << 20  # of the loop's thread: little is needed, and all of it is locked in memory


class Session:
    """A running scene. Made by `start`; every method may be called from any thread."""

    def __init__(self, scene: Scene, loop: Loop, body: Callable[[Loop], int], recorder: Recorder) -> None:
        self._loop, self._body, self._recorder = loop, body, recorder
        self._parameters = LiveParameters(scene, loop.parameters)
        self._ending: int | None = None
        self._thread = threading.Thread(target=self._work, name="haptic loop")
        self._reader = threading.Thread(target=self._read, name="telemetry")
        self._over = threading.Event()
        self._trace: Trace | None = None
        self.grants: list[Grant] = []
        """What the real-time set-up asked of the system, and got."""

    @property
    def scene(self) -> Scene:
        """The scene as it is now, with every change that was made."""
        return self._parameters.scene

    def set(self, changes: Mapping[str, Mapping[str, float]], over: float = 0.02) -> None:
        """Changes parameters between two samples, all or nothing: `{"touch": {"stiffness": 500.0, "damping": 2.0},
        "wall": {"position": 0.01}}`, in the scene's names and units.

        They are led there within `over` seconds (0: at once), no value by more than 1.5/N of its way in one of the N
        samples. A set that comes while another is on its way takes all values over, and brings them there in its own
        time. UsageError where a name, a key or a value is wrong, or what is asked for cannot change while the scene
        runs; nothing has changed then.
        """
        self._require_running()
        self._parameters.set(changes, over)

    def adopt(self, scene: Scene, over: float = 0.02) -> None:
        """Changes parameters to those of `scene`, which may differ from the running one in nothing else; as `set`."""
        self._require_running()
        self._parameters.adopt(scene, over)

    def progress(self) -> Progress:
        """How it is doing."""
        return progress_of(self._loop)

    def statistics(self) -> Statistics:
        """Lateness, exchange time and age of the force, of every tick so far."""
        return statistics_of(self._loop)

    def stop(self) -> None:
        """Ends it in good order; returns at once."""
        self._loop.control["stop"] = 1

    def wait(self, timeout: float | None = None) -> bool:
        """Waits until it has ended, at most for `timeout` seconds; whether it has."""
        return self._over.wait(timeout)

    @property
    def trace(self) -> Trace:
        """What happened, once the with-block of `start` is left."""
        if self._trace is None:
            raise UsageError("the trace is there once the run is over: leave the with-block of `start` first")
        return self._trace

    def _require_running(self) -> None:
        if self._over.is_set():
            raise UsageError("the run is over: nothing can be changed any more")

    def _work(self) -> None:
        no_timer_slack()
        try:
            ending = self._body(self._loop)
            while ending == endings.RING_FULL:
                self._recorder.collect()
                ending = self._body(self._loop)
            self._ending = ending
        finally:
            self._over.set()

    def _read(self) -> None:
        while not self._over.wait(_COLLECT_S):
            if not self._loop.ring.cursor["waits"]:
                self._recorder.collect()

    def _begin(self) -> None:
        self._loop.control["go"] = 0
        with _SIZING:  # the size is the whole process's: another session must not take ours for what it was before
            stack = threading.stack_size(_STACK_BYTES)
            try:
                self._thread.start()
            finally:
                threading.stack_size(stack)
        self._reader.start()

    def _go(self) -> None:
        self._loop.control["go"] = 1

    def _end(self) -> int:
        self.stop()
        self._join()
        self._recorder.collect()
        if self._ending is None and self._thread.ident is not None:
            raise HapsimError("the compiled loop ended with an exception, which is a defect of hapsim")
        return endings.STOPPED if self._ending is None else self._ending

    def _join(self) -> None:
        """Waits for the threads that were started."""
        for thread in (self._thread, self._reader):
            if thread.ident is not None:
                thread.join()

    @property
    def _thread_id(self) -> int:
        return self._thread.native_id or 0


@contextlib.contextmanager
def start(
    scene: Scene,
    *,
    duration: float | None = None,
    line: LineKind = "auto",
    excitation: Excitation | None = None,
    keep: bool = True,
    realtime: bool = False,
    portable: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> Iterator[Session]:
    """Starts `scene`, for `duration` seconds (None: until stopped); it runs while the with-block lasts.

    `line`: where the device is ("auto": the scene's port, else the mock that fits the clock). `keep`: False for a trace
    without rows, for runs without an end. `realtime`: asks the system for what makes a loop steady, see
    hapsim.realtime; `Session.grants` tells what it got. `portable`: the loop in plain Python over pyserial.
    `on_progress` hears of the compilation.

    Raises SceneError and UsageError for what cannot be run; DeviceError where port or device fail, GuardError where a
    guard stopped the force, both when the with-block is left; they carry what was recorded as their attribute `trace`.
    """
    if not 1e-3 <= scene.rate <= 1e9:
        raise UsageError(f"rate: found {scene.rate:g} Hz, which no clock keeps (1e-3 to 1e9 Hz)")
    if duration is not None and not 0 < duration * scene.rate < _MOST_TICKS:
        raise UsageError(f"duration: found {duration}, expected a finite number of seconds above 0")
    tell = on_progress or (lambda _: None)
    with (
        on_compilation(lambda name: tell(Progress("compiling", name))),
        open_line(scene, line, portable=portable, realtime=realtime) as opened,
    ):
        description = describe(opened)
        require_fit(scene, opened.name, description)
        loop = assemble_loop(scene, opened, description, excitation, duration)
        # Everything is compiled now: the device is armed only when the loop can answer at once.
        session = Session(scene, loop, _ready_body(scene, opened, loop), Recorder(loop.ring, keep))
        try:
            session._begin()
            with _real_time(session) if realtime else contextlib.nullcontext():
                arm(
                    opened,
                    description,
                    PACING[scene.device.clock],
                    watchdog_samples(scene.rate, description),
                    bool(scene.sensed_links),
                )
                session._go()
                yield session
        finally:
            try:
                ending = session._end()
                session._trace = trace_of(scene, loop, session._recorder, ending)
            finally:
                session._join()  # whatever interrupted the first: nobody else may be on the line
                # The loop let go already; this is for every way out that did not get so far.
                disarm(opened, loop.wire)
    failure = failure_of(opened.name, loop, session.trace, ending)
    if failure is not None:
        raise failure


def _ready_body(scene: Scene, line: Line, loop: Loop) -> Callable[[Any], int]:
    """The loop, compiled: nothing is left to be done when the device is armed."""
    if isinstance(line.port, PortablePort):
        return PortableLoop(loop, line.port).run
    body = run_paced_by_host if scene.device.clock == "host" else run_paced_by_device
    compile_for(body, loop)
    return body


@contextlib.contextmanager
def _real_time(session: Session) -> Iterator[None]:
    with realtime(session._thread_id) as grants:
        session.grants = grants
        yield
