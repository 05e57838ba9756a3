"""`hapsim run` of a scene with several devices: a live line and a record for each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from hapsim.cli import output
from hapsim.cli.live import live_words, words_of_run
from hapsim.errors import RunError
from hapsim.running.reconnecting import RunObserver, observe_all
from hapsim.running.start import start
from hapsim.stopping import stopping_on_signals

if TYPE_CHECKING:
    from hapsim.cli.command_options import RecordOptions
    from hapsim.live.hub import Hub
    from hapsim.running.joint_session import JointSession
    from hapsim.scene import Scene

_LOOK_S = 0.05


def record_files(record: RecordOptions, scene: Scene) -> list[Path]:
    """Returns the records of the devices. Raises UsageError where one cannot be written, or exists."""
    if record.record is None:
        return []
    from hapsim.running.joint_session import record_at

    files = [record_at(record.record, name) for name in scene.ports]
    for file in files:
        replace(record, record=file).require_writable()
    return files


class DevicesRun:
    """The run of a scene with several devices, from its start to its end."""

    def __init__(self, scene: Scene, observers: Mapping[str, RunObserver], hub: Hub | None, served: str) -> None:
        """`observers`: of each device, by name. `hub`: of the views, which show the device `served`; None if nothing is
        served."""
        self._scene, self._hub, self._served = scene, hub, served
        self._observers = dict(observers)
        if hub is not None:
            self._observers[served] = observe_all(self._observers[served], hub.observer)
        self.failure: RunError | None = None
        """Error that ended the run; None if none did."""

    def run(self, options: dict[str, Any]) -> JointSession:
        """Runs the scene until it ends or a signal stops it, with these options of `start`; returns its session. Raises
        the errors of `start` before the devices are armed."""
        armed: list[JointSession] = []

        def stop() -> None:
            if not armed:
                raise KeyboardInterrupt  # nothing is armed yet
            armed[0].stop()

        def meet(joint: JointSession) -> None:
            """Lets a signal and the observers reach the session from now on."""
            armed.append(joint)
            for one in self._observers.values():
                one.begun(joint.stop)
            self._call("arming", joint)

        if self._hub is not None:
            own = self._hub.options
            options |= own | {"on_event": lambda one: one.device == self._served and own["on_event"](one)}
        session: Any = None
        with stopping_on_signals(stop), live_words(output.stderr()) as show:
            try:
                with start(
                    self._scene,
                    on_arming=meet,
                    on_progress=lambda one: show(f"{one.phase} {one.text}"),
                    **options,
                ) as session:
                    self._call("started", session)
                    while not session.wait(_LOOK_S):
                        show(self._look(session))
                    show(self._look(session))
            except RunError as error:
                if session is None:
                    raise
                self.failure = error
            finally:
                for one in self._observers.values():
                    one.over()
        if self._hub is not None:
            self._hub.ended(self.failure)
        return cast("JointSession", session)

    def _call(self, what: str, joint: JointSession) -> None:
        """Calls the observer of each device with its session."""
        for name, one in self._observers.items():
            getattr(one, what)(joint.ports[name])

    def _look(self, joint: JointSession) -> str:
        """Passes on what the devices report; returns their live lines."""
        lines = []
        for name, progress in joint.progress().items():
            use_units(joint.ports[name].scene)
            self._observers[name].running(progress)
            lines.append(f"{name} {words_of_run(progress)}")
        return "\n".join(lines)


def use_units(scene: Scene) -> None:
    """Sets the units of later output to those of a device, whose scene this is."""
    output.set_output_units(scene.units, *map(scene.units_of, range(scene.channels)))
