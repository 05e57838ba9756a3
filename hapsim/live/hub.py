"""The live model of a run, from its first arming to its end, whatever sessions it has: what the views show and change.

A view may call everything here from any thread. Changes are made one after the other in a thread of the hub's own;
those that wait meanwhile are made together, so that a stream of them costs what the loop can use and no more.
"""

from __future__ import annotations

import math
import os
import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeVar

from hapsim.errors import GuardError, HapsimError, UsageError
from hapsim.running.live_parameters import Parameter, changes_from, parameters_of
from hapsim.running.reconnecting import RunObserver
from hapsim.running.saving import path_named
from hapsim.running.session import Session
from hapsim.running.session_view import Event, EventKind, State
from hapsim.scene import Scene, parse_scene

HISTORY_S = 60.0
"""History sent to a view that connects late, s."""
NO_SESSION = "nothing runs at the moment: the device is not armed"

_MOST_EVENTS = 500
_MOST_WAITING = 10_000  # changes

MOST_ADOPTED = 1000
"""Modules and masses of structures that a client may adopt, if no more run already. As many take up to 10 s of work,
in which other changes wait; ten times as many take minutes."""


Result = TypeVar("Result")


class _Change(NamedTuple):
    values: Mapping[str, Any]
    over: float
    done: Future[Any]
    alone: Callable[[Session], Any] | None = None
    """Work that replaces setting the values, done by itself; the future has its result."""


class Hub:
    """The live model of a run. Its `observer` and `on_event` connect it to `keep_running`."""

    def __init__(self, scene: Scene, record_dir: Path | None = None, name: str = "") -> None:
        """`name`: the scene's, without a path. `record_dir`: for records that a view begins; None: no view may."""
        self._scene, self.record_dir, self._name = scene, record_dir, name
        self.session: Session | None = None
        """The one that runs."""
        self.events: deque[Event] = deque(maxlen=_MOST_EVENTS)
        """The latest ones, without changes and places."""
        self._listeners: list[Callable[[Event], None]] = []
        self._waiting: deque[_Change] = deque()
        self._news = threading.Condition()
        self._is_over = False
        self._known: dict[str, Parameter] = {}
        self._stop_run: Callable[[], None] = lambda: None
        self._go_on: Callable[[], None] | None = None  # while the run waits for that
        self._record: Path | None = None  # the latest that a view began
        self._before: dict[str, Any] = {}  # the values of what clients hold, before they held it
        self._leases = ThreadPoolExecutor(1, "live leases")  # a renewal must not wait for the changes
        self._thread = threading.Thread(target=self._make_changes, name="live changes", daemon=True)
        self._thread.start()

    # What views see

    @property
    def scene(self) -> Scene:
        """The scene as it is now."""
        return self._scene if self.session is None else self.session.scene

    @property
    def name(self) -> str:
        """Name of the scene's file, or of the scene, without its directory."""
        return Path(self.scene.path or self._name or "scene").name

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Live parameters, by name."""
        session = self.session
        return parameters_of(self._scene, has_mock=False) if session is None else session.parameters

    @property
    def saved(self) -> Mapping[str, Any]:
        """Values of the live parameters in the scene's file, by name; none where it was made in Python."""
        origin = self.scene.origin
        has_mock = self.session is not None and self.session.has_mock
        return (
            {} if origin is None else {name: one.value for name, one in parameters_of(origin.scene, has_mock).items()}
        )

    @property
    def words(self) -> Mapping[str, int]:
        """Values of inputs and outputs now, by "inputs.touch"; none while nothing runs."""
        return {} if self.session is None else self.session.progress().words

    def state(self) -> State | None:
        """The latest values; None while nothing runs."""
        session = self.session
        return None if session is None else session.state()

    def listen(self, receive: Callable[[Event], None]) -> Callable[[], None]:
        """Calls `receive` with every event, from any thread; it must return at once and not raise. Returns a function
        that ends the calls."""
        self._listeners.append(receive)
        return lambda: self._listeners.remove(receive)

    def publish(self, kind: EventKind, sentence: str = "", values: Mapping[str, Any] | None = None) -> None:
        """Reports an event to all who listen."""
        self.on_event(Event(kind, sentence, values or {}))

    def on_event(self, event: Event) -> None:
        """Passes an event of the session to every listener."""
        if event.kind not in ("changed", "rejected", "place"):  # of which there may be a thousand a second
            self.events.append(event)
        for receive in self._listeners.copy():
            receive(event)

    @property
    def phase(self) -> Literal["running", "waiting", "ended"]:
        """Phase of the run; "waiting" for a session, "ended" if none will come."""
        return "ended" if self._is_over else "waiting" if self.session is None else "running"

    # What views do

    def set(self, values: Mapping[str, Any], over: float = 0.02) -> Future[None]:
        """Changes parameters by their whole names, `{"touch.stiffness": 1500.0}`, all or none. The future is done when
        the loop has them, or raises UsageError with the reason why nothing was changed."""
        return self._wait_in_turn(_Change(values, over, Future()))

    def in_turn(self, work: Callable[[Session], Result]) -> Future[Result]:
        """Does `work` with the running session after the changes before it. The future has its result, or raises
        UsageError."""
        return self._wait_in_turn(_Change({}, 0.0, Future(), work))

    def _wait_in_turn(self, change: _Change) -> Future[Any]:
        done = change.done
        with self._news:
            if self._is_over:
                done.set_exception(UsageError(NO_SESSION))
            elif len(self._waiting) >= _MOST_WAITING:
                done.set_exception(UsageError(f"more than {_MOST_WAITING} changes wait already: send fewer"))
            else:
                self._waiting.append(change)
                self._news.notify()
        return done

    def hold(self, values: Mapping[str, Any], over: float = 0.02) -> Future[None]:
        """Changes parameters as `set` does, until `release`."""
        if not values.keys() <= self._before.keys():
            known = self.parameters
            self._before = {name: known[name].value for name in values if name in known} | self._before
        return self.set(values, over)

    def release(self) -> Future[None] | None:
        """Gives back what clients hold. Returns the change; None if they hold nothing."""
        values, self._before = self._before, {}
        return self.set(values) if values else None

    def adopt(self, text: str, over: float = 0.02) -> None:
        """Changes to the scene of this text; the device stays, whatever port the text names. Takes as long as it has to
        be compiled and predicted. Raises SceneError and UsageError."""
        session = self._running()
        wanted = self._as_sent(session, text)
        device = wanted.device.model_copy(update={"port": session.scene.device.port})
        session.adopt(wanted.model_copy(update={"device": device}), over)

    def lease(self, seconds: float | None, fallback: str | None, owner: object) -> Future[None]:
        """Begins or renews a lease of this owner, `seconds` long, or ends it: 0. None renews it for as long as before.
        `fallback`: the text of a scene, as of `Session.lease`. The future raises UsageError and SceneError."""

        def ask() -> None:
            """Begins, renews or ends it, in the thread of leases."""
            session = self._running()
            if seconds is None:
                session.renew(owner=owner)
            else:
                session.lease(seconds or None, fallback and self._as_sent(session, fallback), owner=owner)

        return self._leases.submit(ask)

    @staticmethod
    def _as_sent(session: Session, text: str) -> Scene:
        wanted = parse_scene(text, "the scene that was sent")
        if (size := _size(wanted)) > (most := max(_size(session.scene), MOST_ADOPTED)):
            expected = f"expected at most {most}, or as many as run: start a larger scene with hapsim run"
            raise UsageError(f"the scene that was sent: found {size} modules and masses of structures, {expected}")
        return wanted

    def mark(self, text: str) -> None:
        """Notes that something happened now."""
        self._running().mark(text)

    def stop(self) -> None:
        """Ends the run: the force goes to zero, or a device that is away is not awaited any longer. Returns at once."""
        self._stop_run()
        if (session := self.session) is not None:
            session.stop()

    @property
    def can_go_on(self) -> bool:
        """True while the run waits for `go_on`: this machine was too slow for it."""
        return self._go_on is not None

    def go_on(self) -> None:
        """Lets the run go on that this machine's slowness ended. Raises UsageError if none waits for that."""
        go_on, self._go_on = self._go_on, None
        if go_on is None:
            raise UsageError(
                f"found a run that is {self.phase}, expected one that waits to go on because this machine held it up"
            )
        go_on()

    def record(self, is_on: bool) -> Path | None:
        """Begins a record in the hub's directory, named by the time, or ends the present one. Returns its file. Raises
        UsageError where the present one is not a view's."""
        session = self._running()
        if (present := session.recording) not in (None, self._record):
            raise UsageError(
                f"found the record {present}, which hapsim was started with: it lasts as long as the run. Expected no "
                "record, or one that a client began"
            )
        if not is_on:
            return session.stop_recording()
        if self.record_dir is None:
            raise UsageError("no record can be begun from here: hapsim was started without --record-dir DIR")
        path = self.record_dir / f"{Path(self.name).stem}-{datetime.now(UTC):%Y%m%dT%H%M%S.%f}.trace"
        session.record(path)
        self._record = path
        return path

    def save(self, name: str | None) -> Path:
        """Saves the live values in the scene's own file, or, with `name`, the scene in a new one: in the directory of
        records, else beside the scene's file, else in the working directory. Returns the file. Raises UsageError, also
        for a name that is no plain one."""
        session = self._running()
        if (released := self.release()) is not None:  # a drag is not saved; it goes on with its next move
            released.result()
        if name is None:
            return session.save()
        folder = os.path.dirname(session.scene.path or "")
        return session.save(path_named(name, self.record_dir or Path(folder)))

    # What the run does

    @property
    def observer(self) -> RunObserver:
        """Observer that keeps the hub up to date."""
        return RunObserver(
            self._begun, started=self._started, over=self._over, paused=self._paused, report=self.publish
        )

    @property
    def options(self) -> dict[str, Any]:
        """Arguments that the hub needs `start` to be called with."""
        return {"on_event": self.on_event, "history_s": HISTORY_S}

    def ended(self, failure: HapsimError | None) -> None:
        """The run is over for good. `failure`: why it did not end as asked."""
        with self._news:
            self._is_over, self._go_on = True, None
            self._news.notify()
        if isinstance(failure, GuardError):
            self.publish("guard", str(failure))
        self.publish("ended", str(failure or ""))

    def _begun(self, stop: Callable[[], None]) -> None:
        self._stop_run = stop

    def _started(self, session: Session) -> None:
        self.session, self._known = session, session.parameters
        self.publish("armed", f"{session.scene.path or 'the scene'} runs on {session.name}")

    def _paused(self, go_on: Callable[[], None]) -> None:
        self._go_on = go_on

    def _over(self) -> None:
        if self.session is not None:
            self._scene, self.session = self.session.scene, None

    def _running(self) -> Session:
        if self.session is None:
            raise UsageError(NO_SESSION)
        return self.session

    def _make_changes(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._waiting or self._is_over)
                taken = [change for change in self._waiting if change.done.set_running_or_notify_cancel()]
                self._waiting.clear()
                if self._is_over and not taken:
                    return
            apart = len({change.over for change in taken}) > 1 or any(change.alone for change in taken)
            if apart or not self._made(taken):
                for change in taken:
                    self._made([change], or_reject=True)

    def _made(self, together: list[_Change], or_reject: bool = False) -> bool:
        """Makes these changes as one; returns whether it could. `or_reject`: reports why not."""
        values = {name: value for change in together for name, value in change.values.items()}
        _, over, _, alone = together[0]
        try:
            session = self._running()
            result = self._set_now(session, values, over) if alone is None else alone(session)
        except Exception as error:  # a defect must not end this thread
            known = error if isinstance(error, HapsimError) else UsageError(f"a defect of hapsim itself: {error!r}")
            if or_reject:
                self.publish("rejected", str(known), values)
                together[0].done.set_exception(known)
            return False
        for change in together:
            change.done.set_result(result)
        return True

    def _set_now(self, session: Session, values: Mapping[str, Any], over: float) -> Any:
        if not values.keys() <= self._known.keys():  # names stay what they are: no list of all for each change
            self._known = session.parameters
        session.set(changes_from(values, self._known), over)


def _size(scene: Scene) -> int:
    structures = (math.prod(getattr(one, count) for count in one.counts) for one in scene.structures.values())
    return len(scene.modules) + sum(structures)
