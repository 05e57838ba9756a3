"""`start`: the session of a scene, of one device or of several."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Concatenate, ParamSpec, cast

from hapsim.device.open_connection import on_device, transport_here
from hapsim.running.session import Session
from hapsim.running.session_options import RunOptions
from hapsim.scene.load import SceneSource, as_scene

_Keywords = ParamSpec("_Keywords")


def _with_keywords_of(
    options: Callable[_Keywords, RunOptions],
) -> Callable[[Callable[..., Session]], Callable[Concatenate[SceneSource, _Keywords], Session]]:
    """Decorates a function with the keywords of `options`, for type checkers and for `help`."""

    def declared(function: Callable[..., Session]) -> Callable[Concatenate[SceneSource, _Keywords], Session]:
        """Returns the function with these keywords in its signature."""
        signature = inspect.signature(function)
        scene = signature.parameters["scene"]
        keywords = inspect.signature(options).parameters.values()
        function.__signature__ = signature.replace(parameters=[scene, *keywords])  # type: ignore[attr-defined]
        return function

    return declared


@_with_keywords_of(RunOptions)
def start(scene: SceneSource, **options: Any) -> Session:
    """Starts `scene`, a Scene or the path of a scene file, and returns its session; of a scene with several devices a
    `JointSession`, which has one session for each.

    The session runs for `duration` seconds (default: no limit), until it is stopped or closed, until its with-block is
    left, and no longer than the program.

    * `transport`: where the device is ("auto": the scene's port, or without one the mock that fits the clock; "paced":
      the mock in memory, in real time, which `hapsim run --serve` uses: no late sample ends it).
    * `excitation`: a force that is added to the scene's (`Excitation`, `PeriodicExcitation`).
    * `keep`: False returns a trace without rows, for runs without an end.
    * `record`: a .trace, .npz or .csv file that is written while the scene runs, in place of an existing one. Memory
      use does not grow, and `load_trace` reads what was written before a crash.
    * `reports`: the directory for the report file of a run that a guard, a device fault or a lost device ended.
      Default: a directory of the user's where the device is on a port; no file for the mock.
    * `realtime`: requests real-time privileges (hapsim.loop.realtime); `Session.grants` lists what was granted.
    * `portable`: runs the loop in plain Python over pyserial, as systems other than Linux always do. There the mock is
      in memory, in real time too.
    * `between`: wraps the transport to the device. The loop then runs in Python.
    * `unstable`: permission for a scene that is certainly predicted unstable. False rejects it at the start and as a
      change (`Session.set`, `Session.adopt`). True accepts it, and the energy guard applies stricter rules
      (hapsim/STABILITY.md). None accepts it at the start and in `set`; `adopt` rejects what is less stable than the
      running scene.
    * `judges_energy`: enables the energy guard for the mock, as `hapsim run` does. Behind a port, and for scenes that
      name `energy_limit`, it is always enabled.
    * `judges_sign`: stops a motor that pushes the wrong way for the mock, too. Behind a port it always does.
    * `on_progress`: called during compilation.
    * `on_warning`: called with a sentence before arming, if a port's motor is not known to push the right way and has
      a tenth of the force limit (hapsim/STABILITY.md); and, from another thread, if a file can no longer be written or
      the sound card is gone.
    * `on_arming`: called with the session just before the device is armed. From then on `stop` ends the run cleanly.
    * `on_event`: called with an `Event` after each change, marker, recording and new place of a detent, from the thread
      that caused it.
    * `history_s`: how many seconds `Session.history` returns.
    * `resumes`: the device took forces before. `Session.restarted` then says whether it powered up since, so that
      its zero has changed; where the scene counts from that zero, the device is not armed.
    * `also_sense`: values that the device sends too if it has the sensors and longer frames cause no further delay
      ("velocity", "acceleration"). `Trace.sensed` has them.
    * `sound`: plays the scene's sound on `sound_device` (a name, part of one or a number of `hapsim sound`; default:
      the system's), `volume_db` (dB) louder than full scale, `latency_s` after a position has arrived, or as soon as
      the card can. `sound_file`: a .wav to write, also in virtual time.
    * `lsl`: name of two streams of Lab Streaming Layer, the samples and the events, in real time only.

    Raises SceneError and UsageError for a scene or options that cannot run, and DeviceError if the port or the device
    fails. Later errors are raised when the with-block is left, in place of a UsageError too, or by `Session.close`:
    DeviceError, GuardError if a guard stopped the force, RecordError if only the record failed. Their attribute `trace`
    holds the trace so far. If a session is never closed, the message is printed when the program ends.
    """
    record = RunOptions(**options)  # first: an unknown keyword is a TypeError, whatever the scene
    scene = as_scene(scene)
    if scene.ports:
        from hapsim.running.joint_session import JointSession  # with the loop of several ports

        joint = JointSession(scene, record)
        joint.begin()
        return cast(Session, joint)
    record = replace(record, transport=transport_here(scene, record.transport))
    session = Session(on_device(scene, record.transport), record)
    session.begin()
    return session
