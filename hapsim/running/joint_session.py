"""A session of several devices: one scene, an ordinary `Session` for each port, and one thread that runs their loop.

Each session records, reports and counts as that of one device. This file opens them all before any is armed, arms them
all before any takes a force, and ends them together: if a port fails, the loop releases the others.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, NoReturn

from hapsim.compiling.kept import compile_for
from hapsim.device.open_connection import on_device, transport_here
from hapsim.errors import HapsimError, RunError, UsageError
from hapsim.loop import endings
from hapsim.loop.counts import Progress
from hapsim.loop.guards.energy_guard import set_predicted_unstable
from hapsim.loop.joint_loop import run_loops
from hapsim.loop.realtime import remove_timer_slack
from hapsim.prediction import surely_shaken_by
from hapsim.recording.trace import Trace
from hapsim.running import outcome
from hapsim.running.assemble_joint import JointMemory
from hapsim.running.changed_scene import Changes, changed
from hapsim.running.live_parameters import MOCK_HAND, by_part, mock_hand_of, python_values
from hapsim.running.saving import save
from hapsim.running.session import Session, begin_together
from hapsim.running.session_options import RunOptions
from hapsim.running.session_view import Closing, Event
from hapsim.scene import Scene

_ONE_DEVICE = "cannot be done in a scene with several devices"


class PortSession(Session):
    """The session of one of several devices."""

    _LOOP_UNITS: ClassVar[tuple[str, ...]] = ()  # the joint loop is compiled instead

    joint: JointSession

    def _compile_loop(self) -> None:
        if self._in_python:
            expected = "expected Linux, without `portable` and `between`"
            raise UsageError(f"found a loop in Python for several devices, {expected}")

    def set(self, changes: Changes, over: float = 0.02) -> None:
        """Changes live parameters as `JointSession.set`, so that all devices have the same link; "mock.hand" is the
        hand of this device's mock."""
        changes = by_part(python_values(changes), self.scene) if isinstance(changes, Mapping) else changes
        own = changes.get(MOCK_HAND) if isinstance(changes, Mapping) else None
        others = {part: keys for part, keys in changes.items() if part != MOCK_HAND} if own else changes
        self.joint.set(others | {mock_hand_of(self.device): own} if own else others, over)

    @property
    def device(self) -> str:
        """Name of its device."""
        assert self.scene.at is not None
        return self.scene.at.device

    def adopt(self, *_: Any, **__: Any) -> NoReturn:
        """Raises UsageError, as the changes below: they would change one device's part of the scene alone."""
        raise UsageError(f"adopt {_ONE_DEVICE}: `set` changes live values in all of them")

    def trial(self, *_: Any, **__: Any) -> NoReturn:
        """Raises UsageError."""
        raise UsageError(f"a trial {_ONE_DEVICE}: `set` changes live values, `mark` marks the samples")

    def lease(self, *_: Any, **__: Any) -> NoReturn:
        """Raises UsageError."""
        raise UsageError(f"a lease {_ONE_DEVICE}")

    def save(self, path: str | Path | None = None) -> Path:
        """Writes the live values of the whole scene, as `JointSession.save`."""
        return self.joint.save(path)


class JointSession(Closing):
    """A running scene of several devices. Made by `start`; every method may be called from any thread. An error that
    ended it names the device that failed.

    Attributes:
        ports: a `Session` for each device, by name, for what concerns one: state, samples, history, pulses, records.
    """

    def __init__(self, scene: Scene, options: RunOptions) -> None:
        """Opens all devices, compiles and assembles their loop. Nothing is armed."""
        if options.unstable is False and (shaken := surely_shaken_by(scene)) is not None:
            raise UsageError(f"not armed: the scene is predicted unstable: {shaken.sentence(scene.units)}")
        self._scene, self._options, self._changing = scene, options, threading.Lock()
        self.ports: dict[str, PortSession] = {}
        self._thread = threading.Thread(target=self._run_loops, name="haptic loop", daemon=True)
        with contextlib.ExitStack() as stack:
            stack.callback(self._end)
            for name in scene.ports:
                self._open(name)
            loops = {name: one._loop for name, one in self.ports.items()}
            self._memory = JointMemory({name: one.scene for name, one in self.ports.items()}, loops)
            compile_for(run_loops, self._memory.record)
            for one in self.ports.values():
                if options.unstable and one._loop.has_energy_guard and self._is_shaken(one.scene):
                    set_predicted_unstable(one._loop.record.energy_guard, unstable=True)
            stack.pop_all()

    def _is_shaken(self, at_port: Scene) -> bool:
        """Returns whether the scene surely shakes a hand, also that of a port whose others are held still."""
        return any(surely_shaken_by(one) is not None for one in (self._scene, at_port))

    def _open(self, name: str) -> None:
        """Opens a device. Errors name it."""
        scene, options = self._scene.at_port(name), self._options_of(name)
        options = replace(options, transport=transport_here(scene, options.transport))
        try:
            session = PortSession(on_device(scene, options.transport), options)
        except HapsimError as error:
            error.args = (f"{name}: {error.args[0]}", *error.args[1:]) if error.args else error.args
            raise
        session.joint, session._thread, session._live.is_shaken = self, self._thread, self._is_shaken
        self.ports[name] = session

    def _options_of(self, name: str) -> RunOptions:
        """Returns the options of a device's session: with a record of its own, and the sound of the leader's."""
        own, is_leader = self._options, name == self._scene.leader
        excitation = own.excitation.get(name) if isinstance(own.excitation, Mapping) else own.excitation
        if excitation is not None and excitation is own.excitation:
            raise UsageError("excitation: found one for a scene with several devices, expected {device: excitation}")

        def publish(event: Event) -> None:
            if own.on_event is not None:
                own.on_event(replace(event, device=name))

        def warn(sentence: str) -> None:
            if own.on_warning is not None:
                own.on_warning(f"{name}: {sentence}")

        return replace(
            own,
            record=None if own.record is None else record_at(own.record, name),
            excitation=excitation,
            on_event=publish,
            on_warning=warn,
            on_arming=None,
            realtime=own.realtime and name == self._scene.ports[0],
            sound=own.sound and is_leader,
            sound_file=own.sound_file if is_leader else None,
            lsl=None if own.lsl is None else f"{own.lsl}-{name}",
        )

    def begin(self) -> None:
        """Arms the devices and starts the loop. If this fails, everything is released."""
        begin_together([*self.ports.values()], self._thread, self._options.on_arming, self, self._end)

    def __repr__(self) -> str:
        return f"<JointSession: {self.scene.path or 'a scene'} on {', '.join(map(repr, self.ports.values()))}>"

    @property
    def scene(self) -> Scene:
        """Current scene, with every change so far."""
        return self._scene

    @property
    def traces(self) -> dict[str, Trace]:
        """Trace of each device, by name, once the session has ended. Raises UsageError before."""
        return {name: one.trace for name, one in self.ports.items()}

    def progress(self) -> dict[str, Progress]:
        """Returns the counters of each device now, by name."""
        return {name: one.progress() for name, one in self.ports.items()}

    def stop(self) -> None:
        """Ends the run cleanly; returns at once."""
        for one in self.ports.values():
            one.stop()

    def wait(self, timeout: float | None = None) -> bool:
        """Waits for at most `timeout` seconds. Returns whether the run has ended and all devices are disarmed."""
        end = None if timeout is None else time.monotonic() + timeout
        ports = self.ports.values()
        return all(one.wait(None if end is None else max(end - time.monotonic(), 0.0)) for one in ports)

    def mark(self, text: str = "") -> None:
        """Marks this moment in the record of each device."""
        for one in self.ports.values():
            one.mark(text)

    def save(self, path: str | Path | None = None) -> Path:
        """Writes the live values into the scene's file, or the scene into a new one, as `Session.save`."""
        with self._changing:
            file = save(self._scene, path)
            self._scene = self._scene.read_from(file.path, file.origin)
        return Path(file.path or "")

    def set(self, changes: Changes, over: float = 0.02) -> None:
        """Changes live parameters as `Session.set`, of a link between two devices at both. "mocks.left.hand" is the
        hand that holds the mock of left. Raises UsageError, and changes nothing, as that does."""
        changes, over = python_values(changes), python_values(over)
        with self._changing:
            changes = by_part(changes, self._scene) if isinstance(changes, Mapping) else changes
            parts = {name: self._changes_at(name, changes) for name in self.ports}
            hands = {mock_hand_of(name) for name in self.ports}
            whole = changed(self._scene, {part: keys for part, keys in changes.items() if part not in hands})
            scenes = {name: changed(self.ports[name].scene, own) for name, own in parts.items()}
            mocks = {name: scene.mock for name, scene in scenes.items() if scene.mock is not None}
            whole = whole.model_copy(update={"mocks": mocks})
            if self._options.unstable is False and (shaken := surely_shaken_by(whole)) is not None:
                raise UsageError(f"the scene is predicted unstable: {shaken.sentence(whole.units)}")
            before, self._scene = self._scene, whole  # the energy guards judge it
            try:
                for name, own in parts.items():
                    if own:
                        Session.set(self.ports[name], own, over)
            except UsageError:
                self._scene = before
                raise

    def _changes_at(self, name: str, changes: Changes) -> dict[str, Any]:
        """Returns what these changes are at a port."""
        scene = self.ports[name].scene
        own = {one for one in scene.modules if one not in {away.name for away in scene.away}} | {*scene.sound}
        found = {part: keys for part, keys in changes.items() if part in own}
        hand = changes.get(mock_hand_of(name))
        return found if hand is None else found | {MOCK_HAND: hand}

    def _run_loops(self) -> None:
        remove_timer_slack()
        sessions = self.ports.values()
        try:
            ending = run_loops(self._memory.record)
            while ending == endings.RING_FULL:
                for one in sessions:
                    one._make_room()
                ending = run_loops(self._memory.record)
            for name, one in self.ports.items():
                one._ending = self._memory.ending(name)
        finally:
            for one in sessions:
                one._loop_is_over()

    def _end(self) -> BaseException | None:
        """Ends the run and waits until everything is released. Returns the error of the port that failed first, with
        those of others behind it; None if it was raised before, or if none failed."""
        self.stop()
        found = {name: one._end() for name, one in self.ports.items()}
        failed = {name: error for name, error in found.items() if error is not None}
        others = [name for name in failed if self.ports[name]._ending == endings.OTHER_PORT]
        names = [name for name in failed if name not in others] + others
        if not names:
            return None
        first, *more = (failed[name] for name in names)
        for one in more:
            first = outcome.with_sentence(first, f". And {one}") if isinstance(first, RunError) else first
        return first


def record_at(path: str | Path, name: str) -> Path:
    """Returns the record of a device: touch.left.trace for touch.trace."""
    path = Path(path)
    return path.with_name(f"{path.stem}.{name}{path.suffix}")
