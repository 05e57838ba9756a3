"""Wake-up latency of a thread that sleeps to a grid, as in every real-time loop; runs of a scene at one rate; and the
verdict: the share of its forces that this machine sends in time.
"""

from __future__ import annotations

import contextlib
import itertools
import operator
import statistics
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from firmware_protocol.compiled import new_record
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import on_compilation
from hapsim.device.open_connection import TransportKind
from hapsim.errors import RunError, UsageError
from hapsim.loop.clocks import GRID, sleep_on_grid
from hapsim.loop.counts import Progress
from hapsim.loop.histogram import Histogram, histogram_of
from hapsim.loop.system import missing_calls
from hapsim.number_format import frequency, share_in_percent
from hapsim.scene import Clock, Link, Scene

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult
    from hapsim.recording.trace import Report, Trace

OnProgress = Callable[[float, str], None]
"""Called with the time (s) since a measurement began, and the function that is being compiled for it, or ""."""

_LOOK_S = 0.05
_SLEEPS = 100
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 1e5
_MOST_WAKEUPS = 1e12


def require_measurable(rate_hz: float, seconds: float, named: str = "--rates") -> None:
    """Raises UsageError unless the rate is between 1 Hz and 100 kHz, with at least a period in the time. `named`: where
    the rate stands."""
    if not _SLOWEST_HZ <= rate_hz <= _FASTEST_HZ:
        raise UsageError(f"{named}: found {rate_hz:g} Hz, expected {_SLOWEST_HZ:g} to {_FASTEST_HZ:g} Hz")
    if not 1.0 <= rate_hz * seconds <= _MOST_WAKEUPS:
        raise UsageError(
            f"--seconds: found {seconds:g}, expected at least a period of {rate_hz:g} Hz, "
            f"and at most {_MOST_WAKEUPS / rate_hz:g}"
        )


def wake_up_latency(
    rate_hz: float,
    seconds: float,
    on_progress: OnProgress = lambda _elapsed, _compiling: None,
    *,
    realtime: bool = False,
    on_grants: Callable[[list[PrivilegeResult]], None] = lambda _grants: None,
) -> Histogram:
    """Returns the wake-up latencies (s) of a thread that sleeps to a grid of `rate_hz` for this many `seconds`.

    It counts `rate_hz * seconds` wake-ups, fewer if some came a whole period late. With `realtime` the thread first
    requests real-time scheduling; `on_grants` gets the result. An exception, such as Ctrl-C, ends it at the next
    wake-up. Raises UsageError as `require_measurable` does.
    """
    require_measurable(rate_hz, seconds)
    grid = new_record(GRID)
    grid.period_ns = round(1e9 / rate_hz)
    sleep: Any = sleep_on_grid
    if missing_calls():
        sleep = sleep.py_func  # as the loop sleeps there
    else:
        with on_compilation(lambda name: on_progress(0.0, name)):
            compile_for(sleep, grid)

    def work() -> None:
        """Runs in its own thread, so that the calling one receives Ctrl-C and reports progress."""
        with _punctual(realtime) as grants:
            on_grants(grants)
            now = time.monotonic_ns()
            grid.due_ns = now + int(grid.period_ns)
            grid.end_ns = now + round(rate_hz * seconds) * int(grid.period_ns)
            sleep(grid)

    with ThreadPoolExecutor(1, "wake-ups") as pool:
        working = pool.submit(work)
        try:
            while not working.done():
                wait([working], _LOOK_S)
                on_progress(int(grid.wakeups) * int(grid.period_ns) * 1e-9, "")
        finally:
            grid.stop = 1
        working.result()
    return histogram_of(grid.lateness, 1e-9)


def shortest_sleep_s() -> float:
    """Returns the median duration of a sleep of a microsecond, s: the step of the system's timer."""
    times = [time.perf_counter()]
    for _ in range(_SLEEPS):
        time.sleep(1e-6)
        times.append(time.perf_counter())
    return statistics.median(map(operator.sub, times[1:], times))


@contextlib.contextmanager
def _punctual(realtime: bool) -> Iterator[list[PrivilegeResult]]:
    """Makes this thread wake up as punctually as possible, at least without the kernel's slack of 50 µs."""
    from hapsim.loop.realtime import realtime as in_real_time
    from hapsim.loop.realtime import remove_timer_slack

    remove_timer_slack()
    if not realtime:
        yield []
        return
    with in_real_time(threading.get_native_id()) as grants:
        yield list(grants)


Run = Callable[..., "Trace"]
"""hapsim.run, or its replacement in a test."""

MOCK = "mock"
_NO_FORCE = 1e-12  # N: less than one count of any device, so that the limit makes every force zero


@dataclass(frozen=True)
class Trial:
    """A run to be made."""

    scene: Scene
    transport: TransportKind

    @property
    def where(self) -> str:
        """The port of the device, or "mock"."""
        return self.scene.device.port if self.transport == "auto" and self.scene.device.port else MOCK

    def in_words(self) -> str:
        """Returns what it measures."""
        where = "the mock" if self.where == MOCK else self.where
        return f"exchanges at {frequency(self.scene.rate)}, clock: {self.scene.device.clock}, on {where}"


@dataclass(frozen=True)
class Exchanges:
    """A run that was made, or one that failed."""

    rate_hz: float
    clock: Clock
    where: str  # the port of the device, or "mock"
    report: Report | None  # None if nothing was recorded
    lateness: Histogram | None  # s, of the loop's wake-ups
    exchange: Histogram | None  # s, of the exchanges
    failure: str = ""  # why the run ended early, in a sentence
    exit_status: int = 0  # of the failure, as in hapsim/errors.py

    @property
    def share_in_time(self) -> float | None:
        """The share (0 to 1) of the forces that came in time; None if nothing ran."""
        return None if self.report is None else share_in_time(self.report, device_asks=self.clock == "device")

    @property
    def share_of_rate(self) -> float | None:
        """The share of the rate that was kept: 0.9 for 900 positions a second instead of 1000."""
        if self.report is None or not self.report.duration_s > 0.0:
            return None
        return self.report.rate_hz / self.report.nominal_rate_hz


def share_in_time(report: Report, *, device_asks: bool) -> float | None:
    """Returns the share (0 to 1) of a run's forces that came in time; None for a run without a tick.

    A late force and a lost position are deadline misses. If the host is the clock, so are forces that it was too slow
    to send at all: a loop that runs at 900 Hz instead of 1000 misses a tenth. If the device asks (`device_asks`), a
    slow rate is the device's, and the numbers of its samples say what it asks for.
    """
    if report.ticks == 0:
        return None
    asked = report.ticks + report.lost_frames
    if not device_asks:
        asked = max(asked, 1 + round(report.duration_s * report.nominal_rate_hz))
    return max(report.ticks - report.deadline_misses, 0) / asked


def trials(scene: Scene, rates: tuple[float, ...], transport: TransportKind) -> list[Trial]:
    """Returns the runs by which a scene is examined.

    With a device: one, as the scene says. With the mock: every rate, under either clock. Raises UsageError if the scene
    would run on its device in virtual time.
    """
    if transport == "auto" and scene.device.port is not None:
        if scene.device.clock == "lockstep":
            raise UsageError(
                "clock: found lockstep, in which nothing can be late; expected device or host, or the mock (--mock)"
            )
        return [Trial(powerless(scene), "auto")]
    clocks: tuple[Clock, ...] = ("device", "host")
    return [Trial(_changed(scene, rate, clock=clock), "terminal") for clock in clocks for rate in rates]


def powerless(scene: Scene) -> Scene:
    """Returns the scene without its links, and with a limit that lets no force through: the hand is never pushed."""
    modules = type(scene.modules)(  # type: ignore[call-arg]
        {name: module for name, module in scene.modules.items() if not isinstance(module, Link)}
    )
    return _changed(scene, scene.rate, force_limit=_NO_FORCE).model_copy(update={"modules": modules})


def _changed(scene: Scene, rate: float, **device: Any) -> Scene:
    return scene.model_copy(update={"rate": rate, "device": scene.device.model_copy(update=device)})


def exchanges(trial: Trial, seconds: float, on_progress: OnProgress, run: Run, *, realtime: bool) -> Exchanges:
    """Makes one run. A failure while it runs is part of the answer; UsageError and SceneError are raised."""

    def pass_on(progress: Progress) -> None:
        on_progress(progress.elapsed_s, progress.text if progress.phase == "compiling" else "")

    options = {"duration": seconds, "transport": trial.transport, "keep": False, "realtime": realtime}
    failure, exit_status = "", 0
    try:
        trace = run(trial.scene, on_progress=pass_on, **options)
    except RunError as error:
        trace, failure, exit_status = error.trace, str(error), error.exit_status
    statistics = None if trace is None else trace.statistics
    return Exchanges(
        trial.scene.rate,
        trial.scene.device.clock,
        trial.where,
        None if trace is None else trace.report,
        None if statistics is None else statistics.lateness,
        None if statistics is None else statistics.exchange,
        failure,
        exit_status,
    )


# The verdict

Answer = Literal["yes", "with gaps", "no", "no verdict"]

YES, WITH_GAPS = 0.999, 0.95

KEPT_BY_MOCK = 0.95  # of the rate: a mock that keeps less asks too little of the loop for any verdict

IN_TIME = {
    "device": "In time: the device had the force when it needed it, as it says itself.",
    "host": "In time: the loop woke up less than a period late, and its force answers the newest position, as the "
    "device says; a force that was never sent is a deadline miss.",
}
"""Meaning of "in time", by clock."""

EXCHANGE = {
    "device": "An exchange lasts from a position's arrival until its force has left.",
    "host": "An exchange lasts from waking up for the tick until the position has arrived, the force sent in between.",
}
"""Meaning of an exchange, by clock."""

ON_THE_MOCK = (
    "The mock keeps the rate. It runs on the same cores and wakes up late like any program; a device has its own "
    "timer. If the mock keeps less than 95 % of the rate, there is no verdict."
)
"""Remark about the mock with clock: device."""


@dataclass(frozen=True)
class Verdict:
    """The verdict on one rate under one clock."""

    rate_hz: float
    clock: str
    where: str
    answer: Answer
    share_in_time: float | None  # 0 to 1; None if nothing was measured
    why: str = ""  # why there is no better answer, if more is known than the share

    @property
    def sentence(self) -> str:
        """4 kHz: yes, 99.98 % in time."""
        in_time = "" if self.share_in_time is None else f", {share_in_percent(self.share_in_time)} in time"
        return f"{frequency(self.rate_hz)}: {self.answer}{in_time}{f' ({self.why})' if self.why else ''}"


def answer_for(share_in_time: float | None) -> Answer:
    """Returns whether a rate is kept that has this share (0 to 1) of its forces in time.

    `yes` from 99.9 %: at 1 kHz at most one force a second is late. `with gaps` from 95 %: it runs, but every late force
    is a moment of twice the delay, delay eats damping, and a stiff scene that is stable on paper may hum. Below, `no`.
    libfranka's communication_test, for a robot at 1 kHz, warns below 95 % and calls a machine not sufficient below
    90 %. A robot's controller bridges a gap by extrapolating its commands, but a held force goes on pushing: so its
    warning is our refusal.
    """
    if share_in_time is None:
        return "no verdict"
    return "yes" if share_in_time >= YES else "with gaps" if share_in_time >= WITH_GAPS else "no"


def verdict_on(exchanges: Exchanges) -> Verdict:
    """Returns the verdict on one run. One that failed is a no, whatever was in time until then; a mock that does not
    keep its rate itself allows none."""
    share, why, kept = exchanges.share_in_time, exchanges.failure, exchanges.share_of_rate
    answer = answer_for(share)
    if why:
        answer = "no" if share is not None else "no verdict"
    elif (exchanges.where, exchanges.clock) == (MOCK, "device") and kept is not None and kept < KEPT_BY_MOCK:
        answer, why = "no verdict", f"the mock itself kept only {share_in_percent(kept)} of the rate"
    return Verdict(exchanges.rate_hz, exchanges.clock, exchanges.where, answer, share, why)


def best_rate(verdicts: Iterable[Verdict], clock: str) -> float | None:
    """Returns the fastest rate (Hz) on the mock under `clock` that is a yes, with every slower one; None if none is."""
    on_mock = sorted((v for v in verdicts if v.clock == clock and v.where == MOCK), key=lambda v: v.rate_hz)
    kept = [v.rate_hz for v in itertools.takewhile(lambda v: v.answer == "yes", on_mock)]
    return kept[-1] if kept else None
