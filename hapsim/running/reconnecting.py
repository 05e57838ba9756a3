"""A run that outlives its device: after an unplug its port is waited for, and the scene goes on as it is by then.

Each time the device is opened, asked what it is, and armed as at the beginning; nothing of the session before is taken
for granted. What a guard stopped stays stopped, and so does what turns out to be another device.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, NamedTuple

from hapsim.device.open_connection import place_of_device
from hapsim.errors import DescriptionError, DeviceError, HapsimError, RunError, UsageError
from hapsim.loop import endings
from hapsim.loop.histogram import Histogram
from hapsim.progress import Progress
from hapsim.recording.trace import Report, Statistics, Trace
from hapsim.running.run import follow, start
from hapsim.running.session import Session
from hapsim.scene import Scene
from hapsim.stopping import stopping_on_signals

LOST = tuple(endings.IN_WORDS[one] for one in (endings.SILENT, endings.HUNG_UP, endings.FAILED, endings.DEVICE_STOPPED))
"""Endings after which a device may come back, as a report tells them."""

_GLANCE_S = 0.05  # a signal or the end of the time is noticed so soon while nothing runs
_PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)  # before each try; the last one again and again
_LONG_S = 10.0  # a session that lasted so long begins with the first pause again


@dataclass
class RunObserver:
    """Who wants to know what becomes of a run, and is called in its thread."""

    arming: Callable[[], None] = lambda: None
    """The device has described itself, and is armed next."""
    started: Callable[[Session], None] = lambda _: None
    """The device is armed."""
    running: Callable[[Progress], None] = lambda _: None
    """Now and then while it is compiled and while it runs."""
    over: Callable[[], None] = lambda: None
    """A session has ended, however it did: nothing is armed."""
    waiting: Callable[[], None] = lambda: None
    """Now and then while the port is waited for."""
    tell: Callable[[str, str], None] = lambda _event, _sentence: None
    """(event, sentence): `lost`, `waiting` (it was tried and failed), `reconnected`."""


def together(*observers: RunObserver) -> RunObserver:
    """Each of them hears of everything, in this order."""

    def each(name: str) -> Callable[..., None]:
        def call(*arguments: Any) -> None:
            for one in observers:
                getattr(one, name)(*arguments)

        return call

    return RunObserver(**{field.name: each(field.name) for field in fields(RunObserver)})


def keep_running(
    scene: Scene,
    observer: RunObserver,
    *,
    reconnect: bool,
    record: Path | None = None,
    duration: float | None = None,
    **options: Any,
) -> Lifetime:
    """Runs `scene` until it ends, a signal stops it, or it fails for good (main thread only).

    `reconnect`: a device that is lost is waited for; the first time it has to be there. `duration`: seconds, those in
    which it is waited for included. `record`: what is recorded, a file for each session (`record_of`). `options`: as of
    `start`. Raises what `start` raises before it armed for the first time; later failures are the Lifetime's.
    """
    if reconnect and place_of_device(scene, options.get("transport", "auto"), portable=True) != "port":
        raise UsageError("--reconnect waits for a device's port: found the mock, which does not go away; leave it out")
    keeper = _Keeper(scene, observer, reconnect, record, duration, options)
    with stopping_on_signals(keeper.stop):
        return keeper.run()


def record_of(path: Path, session: int) -> Path:
    """Where session 0, 1, … is recorded where all of these are free: `touch.npz`, `touch.1.npz`, …"""
    return path if session == 0 else path.with_name(f"{path.stem}.{session}{path.suffix}")


def _places_of(record: Path) -> tuple[Path, Path]:
    """Where it ends up, and where it is written until then."""
    return record, record.with_name(record.name + ".part")


class _Keeper:
    def __init__(
        self,
        scene: Scene,
        observer: RunObserver,
        reconnect: bool,
        record: Path | None,
        duration: float | None,
        options: dict[str, Any],
    ) -> None:
        self._scene, self._observer, self._reconnect = scene, observer, reconnect
        self._record, self._duration, self._options = record, duration, options
        self._state: Literal["starting", "running", "waiting"] = "starting"
        self._stopped = self._time_is_over = False
        self._session: Session | None = None
        self._runs: list[SessionResult] = []
        self._interruptions: list[Interruption] = []
        self._records: list[Path] = []
        self._spent_s = 0.0
        self._number = 0  # of the next record
        self._short = 0  # sessions and tries in a row that came to little

    def stop(self) -> None:
        """From a signal's handler: takes no lock."""
        self._stopped = True
        if self._state == "starting":
            raise KeyboardInterrupt  # nothing is armed yet
        if self._session is not None:
            self._session.stop()

    def run(self) -> Lifetime:
        """Session after session until one ends for good, or the device does not come back."""
        failure: HapsimError | None = self._run_once()
        while failure is not None and self._may_come_back(failure):
            why, begun = str(failure), time.monotonic()
            self._observer.tell("lost", f"{why}. Waiting for {self._port} to answer again")
            at = datetime.now(UTC).isoformat(timespec="milliseconds")
            failure = self._come_back(why, begun, at)
        return lifetime_of(self._runs, failure, self._interruptions, self._records[: len(self._runs)])

    @property
    def _port(self) -> str:
        return self._scene.device.port or ""

    def _may_come_back(self, failure: HapsimError) -> bool:
        lost = isinstance(failure, DeviceError) and self._runs[-1].report.ending in LOST
        helps = not isinstance(failure, DescriptionError)  # waiting
        return self._reconnect and lost and helps and not self._stopped and not self._time_is_over

    def _come_back(self, why: str, begun: float, at: str) -> HapsimError | None:
        """Tries until the device is armed again, and runs; how that session ended. Before that: None where stopped,
        a DeviceError where its time was over."""
        said = ""
        while self._waits_for_port(begun):
            try:
                return self._run_once(lambda session: self._came_back(why, begun, at, session.restarted), begun)
            except (DescriptionError, UsageError) as error:
                self._interruptions.append(Interruption(why, at, time.monotonic() - begun, came_back=False))
                return error
            except KeyboardInterrupt:
                break
            except DeviceError as error:
                self._short += 1
                if str(error) != said:
                    said = str(error)
                    self._observer.tell("waiting", f"{said}. It is tried again until {self._port} answers")
        self._interruptions.append(Interruption(why, at, time.monotonic() - begun, came_back=False))
        if not self._stopped:
            self._time_is_over = True
            return DeviceError(
                f"{self._port}: the device was lost and did not come back within the duration of {self._duration:g} s. "
                f"What had happened: {why}"
            )
        last = self._runs[-1]
        self._runs[-1] = last._replace(report=replace(last.report, ending=endings.IN_WORDS[endings.STOPPED]))
        return None

    def _came_back(self, why: str, begun: float, at: str, restarted: bool) -> None:
        waited = time.monotonic() - begun
        self._spent_s += waited
        self._interruptions.append(Interruption(why, at, waited))
        zero = ". The device restarted: its position 0 is where it powered up or homed" if restarted else ""
        self._observer.tell(
            "reconnected", f"{self._port}: armed again after {waited:.1f} s; the scene goes on as it is now{zero}"
        )

    def _waits_for_port(self, begun: float) -> bool:
        """Pauses, then until there is a file of the port's name; False where it is to end before."""
        pause_over = time.monotonic() + _PAUSES_S[min(self._short, len(_PAUSES_S) - 1)]
        while time.monotonic() < pause_over or not self._port_is_there():
            left = self._left_s(time.monotonic() - begun)
            if self._stopped or (left is not None and left <= 0):
                return False
            self._observer.waiting()
            time.sleep(_GLANCE_S)
        left = self._left_s(time.monotonic() - begun)
        return not self._stopped and (left is None or left > 0)

    def _port_is_there(self) -> bool:
        return not os.path.isabs(self._port) or os.path.exists(self._port)

    def _left_s(self, waiting_s: float = 0.0) -> float | None:
        """Of the duration; None where it has no end."""
        return None if self._duration is None else self._duration - self._spent_s - waiting_s

    def _run_once(
        self, on_armed: Callable[[Session], None] = lambda _: None, waits_since: float | None = None
    ) -> HapsimError | None:
        """One session from open to disarm: the error of one that did not end as asked. Raises where it did not arm.
        `waits_since`: when the device was lost, on the monotonic clock."""
        self._state = "starting"
        failure: RunError | None = None
        try:
            if self._stopped:
                raise KeyboardInterrupt
            left = self._left_s(0.0 if waits_since is None else time.monotonic() - waits_since)
            if left is not None and waits_since is not None:
                left = max(left, self._scene.period)  # what was left a moment ago may be over by now
            options = {
                "duration": left,
                "record": self._record_of_session(),
                "on_arming": self._arming,
                "resumes": bool(self._runs),
                **self._options,
            }
            with start(self._scene, **options) as session:
                on_armed(session)
                self._observer.started(session)
                follow(session, self._observer.running)
            trace = session.trace
        except RunError as error:
            if error.trace is None:
                raise
            failure, trace = error, error.trace
        finally:
            self._state, ended = "waiting", self._session
            self._session = None
            self._observer.over()
        if ended is not None:
            self._scene = ended.scene
        self._add(trace)
        return failure

    def _record_of_session(self) -> Path | None:
        """Of one that may take several tries. The first is called as it was asked for; a later one by the next number
        that no file has, nor what a run that was killed left of one."""
        if self._record is None:
            return None
        if len(self._records) == len(self._runs):
            number = self._number
            while number > 0 and any(map(os.path.lexists, _places_of(record_of(self._record, number)))):
                number += 1
            self._number = number + 1
            self._records.append(record_of(self._record, number))
        return self._records[-1]

    def _arming(self, session: Session) -> None:
        if self._stopped:  # and whoever was interrupted there has passed it over
            raise KeyboardInterrupt
        self._observer.arming()
        self._session, self._state = session, "running"

    def _add(self, trace: Trace) -> None:
        self._runs.append(SessionResult(trace.report, trace.statistics))
        self._spent_s += trace.report.duration_s
        self._short = 0 if trace.report.duration_s > _LONG_S else self._short + 1


# The report of all sessions

_SUMMED = (
    "ticks",
    "duration_s",
    "deadline_misses",
    "lost_frames",
    "crc_errors",
    "stale_positions",
    "limited_ticks",
    "slewed_ticks",
    "faded_ticks",
    "slowed_ticks",
    "withheld_forces",
    "sign_tests",
    "unrecorded_rows",
    "dropped_rows",
    "parameter_changes",
    "garbage_bytes",
)


class SessionResult(NamedTuple):
    """What is kept of one session, from arming to disarming."""

    report: Report
    statistics: Statistics


@dataclass(frozen=True)
class Interruption:
    """The device was lost, and waited for."""

    why: str
    """What happened, in a sentence."""
    at: str
    """When it was noticed: UTC, ISO 8601."""
    waited_s: float
    came_back: bool = True


@dataclass(frozen=True)
class Lifetime:
    """A run from the first arming to the end."""

    report: Report
    """Of all sessions: counts and durations together, quantiles of every tick; how it ended is the last one's."""
    failure: HapsimError | None
    """Why it did not end as asked."""
    interruptions: tuple[Interruption, ...]
    records: tuple[Path, ...] = ()
    """Where its sessions were recorded, of those that were."""

    @property
    def reconnections(self) -> int:
        """How many times the device came back."""
        return sum(one.came_back for one in self.interruptions)


def lifetime_of(
    runs: Sequence[SessionResult],
    failure: HapsimError | None,
    interruptions: Sequence[Interruption] = (),
    records: Sequence[Path] = (),
) -> Lifetime:
    """Of one session or more."""
    return Lifetime(_together(runs), failure, tuple(interruptions), tuple(records))


def _together(runs: Sequence[SessionResult]) -> Report:
    last = runs[-1].report
    if len(runs) == 1:
        return last
    reports = [run.report for run in runs]
    summed = {name: sum(getattr(report, name) for report in reports) for name in _SUMMED}
    samples = sum(report.rate_hz * report.duration_s for report in reports)
    rejected = [report.rejected_by_device for report in reports if report.rejected_by_device is not None]
    return replace(
        last,
        **summed,
        rate_hz=samples / summed["duration_s"] if summed["duration_s"] > 0 else 0.0,
        rejected_by_device=sum(rejected) if rejected else None,
        lateness_s=_sum([run.statistics.lateness for run in runs]).spread(),
        exchange_s=_sum([run.statistics.exchange for run in runs]).spread(),
        age_samples=_sum([run.statistics.age for run in runs]).spread(),
    )


def _sum(histograms: Sequence[Histogram]) -> Histogram:
    counts = sum(one.counts for one in histograms)
    return Histogram(counts, max(one.maximum for one in histograms), histograms[0].unit)  # type: ignore[arg-type]
