"""A run that outlives its device: after an unplug it waits for the port, and then continues the scene as changed.

Each time the device is opened, described and armed as at the beginning. A run that a guard stopped stays stopped, and
so does one that finds another device at the port. A run that this machine's slowness ended may wait until somebody asks
it to go on.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapsim.errors import DescriptionError, DeviceError, HapsimError, RunError, UsageError
from hapsim.loop import endings
from hapsim.loop.counts import Progress
from hapsim.loop.histogram import Histogram
from hapsim.recording.trace import Report, Statistics
from hapsim.running.session import Session, wait_and_report
from hapsim.running.session_view import OfDevice
from hapsim.running.start import start
from hapsim.scene import Scene
from hapsim.stopping import stopping_on_signals

LOST = tuple(endings.IN_WORDS[one] for one in (endings.SILENT, endings.HUNG_UP, endings.FAILED, endings.DEVICE_STOPPED))
"""Endings of a report after which a device may come back."""

_POLL_S = 0.05  # between two checks for a signal or the end of the duration
_PAUSES_S = (0.2, 0.5, 1.0, 2.0, 5.0)  # before each try; the last one repeats
_LONG_S = 10.0  # a session of this length restarts the pauses


@dataclass
class RunObserver:
    """Functions that are called in the thread of the run."""

    begun: Callable[[Callable[[], None]], None] = lambda _: None
    """Called first, with a function that ends the run from any thread."""
    arming: Callable[[Session], None] = lambda _: None
    """Called when the device has described itself, before arming."""
    started: Callable[[Session], None] = lambda _: None
    """Called when the device is armed."""
    running: Callable[[Progress], None] = lambda _: None
    """Called repeatedly during compilation and while the scene runs."""
    over: Callable[[], None] = lambda: None
    """Called when a session has ended in any way: nothing is armed."""
    waiting: Callable[[], None] = lambda: None
    """Called repeatedly while the run waits for the port, or to go on."""
    paused: Callable[[Callable[[], None]], None] = lambda _: None
    """Called when this machine's slowness ended a session, with a function by which any thread lets the run go on."""
    report: Callable[[OfDevice, str], None] = lambda _event, _sentence: None
    """Called with (event, sentence) for the events `lost`, `paused`, `waiting` (a try failed), `reconnected`."""


def observe_all(*observers: RunObserver) -> RunObserver:
    """Returns an observer that calls all of these, in this order."""

    def each(name: str) -> Callable[..., None]:
        """Returns a function that calls this one of every observer."""

        def call(*arguments: Any) -> None:
            for one in observers:
                getattr(one, name)(*arguments)

        return call

    return RunObserver(**{one.name: each(one.name) for one in fields(RunObserver)})


class SessionResult(NamedTuple):
    """Report and statistics of one session."""

    report: Report
    statistics: Statistics


@dataclass(frozen=True)
class Interruption:
    """A loss of the device, and the wait for it."""

    why: str
    """Cause, a sentence."""
    at: str
    """Time of detection: UTC, ISO 8601."""
    waited_s: float
    came_back: bool = True


@dataclass(frozen=True)
class Lifetime:
    """A run from the first arming to the end."""

    report: Report
    """Report of all sessions: sums of counts and durations, quantiles over every tick, the ending of the last one."""
    failure: HapsimError | None
    """Error of the last session; None if it ended normally."""
    interruptions: tuple[Interruption, ...]
    records: tuple[Path, ...] = ()
    """Record files of its sessions."""
    sound_files: tuple[Path, ...] = ()
    """Sound files of its sessions."""

    @property
    def reconnections(self) -> int:
        """Number of times that the device came back."""
        return sum(one.came_back for one in self.interruptions)


def keep_running(
    scene: Scene,
    observer: RunObserver,
    *,
    reconnect: bool,
    can_go_on: bool = False,
    record: Path | None = None,
    sound_file: Path | None = None,
    duration: float | None = None,
    **options: Any,
) -> Lifetime:
    """Runs `scene` until it ends, a signal stops it, or it fails for good (main thread only).

    `reconnect`: wait for a lost device; it must be present at first. `can_go_on`: a run that this machine's
    slowness ended waits until `RunObserver.paused` lets it go on. `duration`: seconds, waits included. `record`,
    `sound_file`: paths for records and sound, a file per session (`record_of`). `options`: as of `start`. Raises the
    errors of `start` before the first arming; later failures are in the Lifetime.
    """
    files = _Files(record), _Files(sound_file)
    reconnector = _Reconnector(scene, observer, reconnect, can_go_on, *files, duration, options)
    observer.begun(reconnector.stop_soon)
    with stopping_on_signals(reconnector.stop):
        return reconnector.run()


def record_of(path: Path, session: int) -> Path:
    """Returns the file of session 0, 1, … if none of the names is taken: `touch.npz`, `touch.1.npz`, …"""
    return path if session == 0 else path.with_name(f"{path.stem}.{session}{path.suffix}")


@dataclass
class _Files:
    """Files of one kind, one for each session. `path`: of the first; None for no files."""

    path: Path | None
    names: list[Path] = field(default_factory=list)
    next: int = 0

    def of_session(self, session: int) -> Path | None:
        """Returns the file of a session, the same for all its tries. The first is `path`; a later one has the next
        number that no file has, nor the unfinished file of a killed run."""
        if self.path is None:
            return None
        if len(self.names) == session:
            name = record_of(self.path, self.next)
            while self.next > 0 and any(map(os.path.lexists, (name, name.with_name(f"{name.name}.part")))):
                self.next += 1
                name = record_of(self.path, self.next)
            self.next += 1
            self.names.append(name)
        return self.names[-1]


@dataclass
class _Reconnector:
    """The sessions of a run. The first fields are the arguments of `keep_running`."""

    scene: Scene
    observer: RunObserver
    reconnect: bool
    can_go_on: bool
    records: _Files
    sound_files: _Files
    duration: float | None
    options: dict[str, Any]
    starting: bool = True
    stopped: bool = False
    session: Session | None = None
    runs: list[SessionResult] = field(default_factory=list)
    interruptions: list[Interruption] = field(default_factory=list)
    lost_at: float | None = None
    """Monotonic time of the loss, s; None while the device is present."""
    short: int = 0
    """Number of short sessions and tries in a row."""
    paused: bool = False
    """True while the run waits for `go_on`."""

    def stop(self) -> None:
        """Stops the run. Called from a signal handler, so it takes no lock."""
        self.stop_soon()
        if self.starting:
            raise KeyboardInterrupt  # nothing is armed yet

    def stop_soon(self) -> None:
        """Stops the run, from any thread; what is opened at the moment is not armed."""
        self.stopped = True
        if (session := self.session) is not None:
            session.stop()

    def go_on(self) -> None:
        """Lets a paused run go on, from any thread."""
        self.paused = False

    def run(self) -> Lifetime:
        """Runs session after session until one ends for good, or the device does not come back."""
        failure = self._run_once()
        while failure is not None and self._may_reconnect(failure):
            self.lost_at, why = time.monotonic(), str(failure)
            at = datetime.now(UTC).isoformat(timespec="milliseconds")
            self.interruptions.append(Interruption(why, at, 0.0, came_back=False))
            self.paused = not self.reconnect
            if self.paused:
                self.observer.paused(self.go_on)
                self.observer.report("paused", f"{why}. `Go on` of the page continues the run, Ctrl-C ends it")
            else:
                self.observer.report("lost", f"{why}. Waiting for {self._port} to answer again")
            failure = self._reconnect(why)
        records, sound_files = (tuple(one.names[: len(self.runs)]) for one in (self.records, self.sound_files))
        return Lifetime(_report_of_all(self.runs), failure, tuple(self.interruptions), records, sound_files)

    @property
    def _port(self) -> str:
        return self.scene.device.port or "the mock"

    def _may_reconnect(self, failure: HapsimError) -> bool:
        if not isinstance(failure, DeviceError) or isinstance(failure, DescriptionError):  # waiting would not help
            return False
        comes_back = self.reconnect or (self.can_go_on and failure.held_up)
        return comes_back and self.runs[-1].report.ending in LOST and self._should_continue()

    def _reconnect(self, why: str) -> HapsimError | None:
        """Tries until the device is armed again, and returns that session's error. If it is never armed: None after a
        stop, a DeviceError after the duration. `why`: cause of the loss."""
        last_error = ""
        while self._wait_for_port():
            try:
                return self._run_once()
            except (DescriptionError, UsageError) as error:
                self._end_wait(came_back=False)
                return error
            except KeyboardInterrupt:
                break
            except DeviceError as error:
                self.short += 1
                if str(error) != last_error:
                    last_error = str(error)
                    self.observer.report("waiting", f"{last_error}. hapsim retries until {self._port} answers")
        self._end_wait(came_back=False)
        if not self.stopped:
            return DeviceError(
                f"{self._port}: the device was lost and did not return within the duration of {self.duration:g} s. "
                f"Cause of the loss: {why}"
            )
        last = self.runs[-1]
        self.runs[-1] = last._replace(report=replace(last.report, ending=endings.IN_WORDS[endings.STOPPED]))
        return None

    def _end_wait(self, came_back: bool) -> float:
        """Records the end of the wait. Returns its duration in s."""
        assert self.lost_at is not None
        waited_s, self.lost_at = time.monotonic() - self.lost_at, None
        self.interruptions[-1] = replace(self.interruptions[-1], waited_s=waited_s, came_back=came_back)
        return waited_s

    def _wait_for_port(self) -> bool:
        """Waits for a pause, for the port's file, and for `go_on`. Returns False if the run must end before."""
        pause_over = time.monotonic() + _PAUSES_S[min(self.short, len(_PAUSES_S) - 1)]
        while self._should_continue():
            is_there = not os.path.isabs(self._port) or os.path.exists(self._port)
            if is_there and not self.paused and time.monotonic() >= pause_over:
                return True
            self.observer.waiting()
            time.sleep(_POLL_S)
        return False

    def _should_continue(self) -> bool:
        left = self._left_s()
        return not self.stopped and (left is None or left > 0)

    def _left_s(self) -> float | None:
        """Returns the remaining duration, s; None without a limit."""
        if self.duration is None:
            return None
        waiting = 0.0 if self.lost_at is None else time.monotonic() - self.lost_at
        spent = sum(run.report.duration_s for run in self.runs) + sum(one.waited_s for one in self.interruptions)
        return self.duration - spent - waiting

    def _run_once(self) -> HapsimError | None:
        """Runs one session. Returns the error of a failed one, else None. Raises if it did not arm."""
        self.starting = True
        failure: RunError | None = None
        try:
            if self.stopped:
                raise KeyboardInterrupt
            left = self._left_s()
            if left is not None and self.runs:
                left = max(left, self.scene.period)  # it may have ended a moment ago
            options = {
                "duration": left,
                "record": self.records.of_session(len(self.runs)),
                "sound_file": self.sound_files.of_session(len(self.runs)),
                "on_arming": self._arming,
                "resumes": bool(self.runs),
                **self.options,
            }
            with start(self.scene, **options) as session:
                if self.lost_at is not None:
                    waited_s = self._end_wait(came_back=True)
                    reset = "The device restarted: its position 0 is where it powered up or homed"
                    sentence = f"armed again after {waited_s:.1f} s; the scene continues as it is now"
                    sentence += f". {reset}" if session.restarted else ""
                    self.observer.report("reconnected", f"{self._port}: {sentence}")
                self.observer.started(session)
                wait_and_report(session, self.observer.running)
            trace = session.trace
        except RunError as error:
            if error.trace is None:
                raise
            failure, trace = error, error.trace
        finally:
            self.starting, ended, self.session = False, self.session, None
            self.observer.over()
        if ended is not None:
            self.scene = ended.scene
        self.runs.append(SessionResult(trace.report, trace.statistics))
        self.short = 0 if trace.report.duration_s > _LONG_S else self.short + 1
        return failure

    def _arming(self, session: Session) -> None:
        if self.stopped:  # a callback swallowed the interrupt
            raise KeyboardInterrupt
        self.observer.arming(session)
        self.session, self.starting = session, False


_SUMMED = ("duration_s", *(one.name for one in fields(Report) if one.type == "int"))


def _report_of_all(runs: Sequence[SessionResult]) -> Report:
    """Returns the report of all sessions together."""
    last, reports = runs[-1].report, [run.report for run in runs]
    if len(runs) == 1:
        return last
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
    counts = np.sum([one.counts for one in histograms], axis=0)
    return Histogram(counts, max(one.maximum for one in histograms), histograms[0].unit)
