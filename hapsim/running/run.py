"""Starting a scene, and running one from beginning to end."""

from __future__ import annotations

import contextlib
import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec

from hapsim.prediction.linear import with_device
from hapsim.progress import Progress
from hapsim.recording.trace import Trace
from hapsim.running.options import RunOptions
from hapsim.running.session import Session
from hapsim.scene.load import SceneSource, as_scene
from hapsim.stopping import stopping_on_signals

_LOOK_S = 0.05  # how often the live line looks at the loop
_Keywords = ParamSpec("_Keywords")


def _with_keywords_of(
    options: Callable[_Keywords, RunOptions],
) -> Callable[[Callable[..., Session]], Callable[Concatenate[SceneSource, _Keywords], Session]]:
    """Declares a function's keywords for type checkers and for `help`: they are those of `options`."""

    def declared(function: Callable[..., Session]) -> Callable[Concatenate[SceneSource, _Keywords], Session]:
        signature = inspect.signature(function)
        scene = signature.parameters["scene"]
        keywords = inspect.signature(options).parameters.values()
        function.__signature__ = signature.replace(parameters=[scene, *keywords])  # type: ignore[attr-defined]
        return function

    return declared


@_with_keywords_of(RunOptions)
def start(scene: SceneSource, **options: Any) -> Session:
    """Starts `scene`, a Scene or the path of a scene file, and returns its session.

    The session runs for `duration` seconds (default: no limit), until it is stopped or closed, until its with-block is
    left, and no longer than the program.

    * `transport`: where the device is ("auto": the scene's port, or without one the mock that fits the clock).
    * `excitation`: a force that is added to the scene's (`Excitation`, `PeriodicExcitation`).
    * `keep`: False returns a trace without rows, for runs without an end.
    * `record`: a .trace, .npz or .csv file that is written while the scene runs. Memory use does not grow, and
      `load_trace` reads what was written before a crash.
    * `reports`: the directory for the report file of a run that a guard, a device fault or a lost device ended.
      Default: a directory of the user's where the device is on a port; no file for the mock.
    * `realtime`: requests real-time privileges (hapsim.loop.realtime); `Session.grants` lists what was granted.
    * `portable`: runs the loop in plain Python over pyserial. Off Linux, this loop also runs the mock in memory.
    * `between`: wraps the transport to the device. The loop then runs in Python.
    * `unstable`: whether a scene that is certainly predicted unstable may run. False rejects it at the start and as a
      change (`Session.set`, `Session.adopt`). True accepts it, and the energy guard applies stricter rules
      (hapsim/STABILITY.md). None accepts it at the start and in `set`; `adopt` rejects what is less stable than the
      running scene.
    * `judges_energy`: enables the energy guard for the mock, as `hapsim run` does. Behind a port, and for scenes that
      name `energy_limit`, it is always enabled.
    * `judges_sign`: stops a motor that pushes the wrong way for the mock, too. Behind a port it always does.
    * `on_progress`: called during compilation.
    * `on_warning`: called, from another thread, with a sentence if a file can no longer be written or the sound card
      is gone.
    * `on_arming`: called with the session just before the device is armed. From then on `stop` ends the run cleanly.
    * `on_event`: called with an `Event` after each change, marker and recording, from the thread that caused it.
    * `history_s`: how many seconds `Session.history` returns.
    * `resumes`: the device took forces before. `Session.restarted` then says whether it powered up since, so that
      its zero has changed; where the scene counts from that zero, the device is not armed.
    * `sound`: plays the scene's sound on `sound_device` (a name, part of one or a number of `hapsim sound`; default:
      the system's), `volume_db` (dB) louder than full scale, `latency_s` after a position has arrived, or as soon as
      the card can. `sound_file`: a .wav to write, also in virtual time.

    Raises SceneError and UsageError for what cannot run, and DeviceError if the port or the device fails. What ends
    the run later is raised when the with-block is left, or by `Session.close`: DeviceError, GuardError where a guard
    stopped the force, RecordError where the run went as asked but its record did not. Their attribute `trace` holds
    what was recorded. If a session is never closed, the message is printed when the program ends.
    """
    record = RunOptions(**options)  # first: an unknown keyword is a TypeError, whatever the scene
    scene = as_scene(scene)
    if record.transport != "auto":
        scene = with_device(scene, port=None)  # nor has the mock the wire of a port
    with scene.units.in_errors():
        session = Session(scene, record)
        session.begin()
    return session


def run(
    scene: SceneSource,
    *,
    on_start: Callable[[Session], None] | None = None,
    stop_on_signals: bool = False,
    **options: Any,
) -> Trace:
    """Runs `scene`, a Scene or the path of a scene file, until it ends, and returns its trace.

    Ctrl-C (a notebook's "interrupt") while the scene runs disarms the device and returns the trace so far; the
    `ending` of its report is then "interrupted". A program that runs several scenes in turn looks at that to end
    itself. Before the device is armed, KeyboardInterrupt is raised.

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
    tell = options.get("on_progress") or (lambda _: None)
    armed: Session | None = None
    stopped = False

    def stop() -> None:
        nonlocal stopped
        stopped = True
        if armed is None:
            raise KeyboardInterrupt  # nothing is armed yet
        armed.stop()

    def arming(session: Session) -> None:
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
            follow(session, tell)
        except KeyboardInterrupt as interrupt:
            if on_interrupt is None:
                raise
            on_interrupt(interrupt)
    return session.trace


def follow(session: Session, tell: Callable[[Progress], None]) -> None:
    """Waits until the session has ended, and reports its progress meanwhile."""
    while not session.wait(_LOOK_S):
        tell(session.progress())
    tell(session.progress())
