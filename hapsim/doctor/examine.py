"""The examination: wake-ups and exchanges at every rate, the verdicts on them, and advice."""

from __future__ import annotations

import contextlib
import itertools
import shlex
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapsim.device.connection import describe
from hapsim.device.open_connection import TransportKind, open_connection
from hapsim.doctor.advice import (
    Situation,
    SystemFiles,
    advice_on,
    cpu_times,
    load_between,
    machine_of,
    machine_without_linux,
)
from hapsim.doctor.exchanges import (
    MOCK,
    best_rate,
    exchanges,
    require_measurable,
    shortest_sleep_s,
    trials,
    verdict_on,
    wake_up_latency,
)
from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.loop.system import missing_calls, require_linux
from hapsim.number_format import frequency
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene, parse_scene

if TYPE_CHECKING:
    from hapsim.doctor.advice import Advice, Load, Machine
    from hapsim.doctor.exchanges import Exchanges, OnProgress, Run, Trial, Verdict
    from hapsim.loop.realtime import PrivilegeResult

RATES_HZ = (1000.0, 2000.0, 4000.0, 10000.0)
_SHIPPED = "first_touch.yaml"


@dataclass(frozen=True)
class Step:
    """One measurement of an examination."""

    number: int  # from 1 on
    of: int
    what: str  # in words: wake-ups at 4 kHz
    elapsed_s: float
    seconds: float  # how long it takes in all
    compiling: str  # the function that is being compiled before it begins, or ""


@dataclass(frozen=True)
class Examination:
    """A machine, and the rates that it keeps."""

    scene: str  # the file of the scene that ran
    rate_hz: float  # the scene's own
    seconds: float  # how long each measurement took
    machine: Machine
    grants: tuple[PrivilegeResult, ...] | None
    """The real-time privileges that were requested; None if none were."""
    wakeups: dict[float, Histogram]  # by rate (Hz): the wake-up latencies (s) of a thread
    exchanges: tuple[Exchanges, ...]
    verdicts: tuple[Verdict, ...]  # one for each of `exchanges`
    load: Load | None
    advice: tuple[Advice, ...]
    shortest_sleep_s: float | None = None  # median; None on Linux, where the loop sleeps to a deadline
    steps: int = 0  # how many measurements it is made of
    stopped_after: int | None = None
    """Number of measurements made before an interrupt; None if it was not interrupted."""

    @property
    def stopped(self) -> str:
        """A sentence about an interrupt, or ""."""
        if self.stopped_after is None:
            return ""
        return f"stopped after {self.stopped_after} of {self.steps} steps: the measurements until then are shown"

    @property
    def best_rates(self) -> dict[str, float | None]:
        """Fastest rate (Hz) that this machine keeps on the mock, by clock; empty if a device was examined."""
        clocks = dict.fromkeys(verdict.clock for verdict in self.verdicts if verdict.where == MOCK)
        return {clock: best_rate(self.verdicts, clock) for clock in clocks}

    @property
    def device_failed(self) -> Exchanges | None:
        """The run whose device, on a port, failed, if any."""
        return next((run for run in self.exchanges if run.failure and run.where != MOCK), None)


def examine(
    scene: Scene | None,
    *,
    seconds: float = 2.0,
    rates: tuple[float, ...] = RATES_HZ,
    realtime: bool = False,
    transport: TransportKind = "auto",
    on_progress: Callable[[Step], None] | None = None,
    tree: SystemFiles | None = None,
    run: Run | None = None,
    ask: Callable[[Trial], None] | None = None,
) -> Examination:
    """Measures how steady this machine is for a haptic loop.

    First a thread sleeps to a grid of each of `rates` (Hz), and of the scene's own, and its wake-up latencies are
    counted. Then `scene` (None: the shipped first_touch) runs: on its device, at its own rate and with zero force, if
    it names a port and `transport` is "auto"; otherwise on the mock, at every rate and under either clock. Each of
    these takes `seconds`, with real-time privileges if `realtime`. Tests replace `tree` (this system's files), `run`
    (hapsim.run) and `ask` (which asks the device for its description).

    A run that fails is part of the answer, and so is what was measured before a KeyboardInterrupt, unless it comes
    before the first result. Raises, before anything is measured, UsageError for rates and times that are impossible
    and for a scene that does not fit its device; DeviceError if no device answers.
    """
    from hapsim.running.run import run_to_end

    tree, run, report = tree or SystemFiles(), run or run_to_end, on_progress or (lambda _: None)
    examined, rates, to_run = _to_measure(scene, seconds, rates, transport, realtime)
    (ask or _ask)(to_run[0])
    before, sleep_s = (None, shortest_sleep_s()) if missing_calls() else (cpu_times(tree), None)
    wakeups, grants, made = _measure(rates, to_run, seconds, realtime, run, report)
    steps, done, granted = len(rates) + len(to_run), len(wakeups) + len(made), tuple(grants) if realtime else None
    verdicts, machine = tuple(map(verdict_on, made)), machine_without_linux() if missing_calls() else machine_of(tree)
    case = Situation(
        tree,
        machine,
        examined.device.port if to_run[0].where != MOCK else None,
        granted,
        worst_wakeup_s=max(histogram.maximum for histogram in wakeups.values()),
        keeps_up=all(verdict.answer == "yes" for verdict in verdicts),
        shortest_sleep_s=sleep_s,
        again=_again(scene, to_run[0].where),
        load=load_between(before, cpu_times(tree), machine.cores_online, tree),
    )
    return Examination(
        examined.path or _SHIPPED,
        examined.rate,
        seconds,
        machine,
        granted,
        wakeups,
        tuple(made),
        verdicts,
        case.load,
        tuple(advice_on(case)),
        sleep_s,
        steps,
        stopped_after=done if done < steps else None,
    )


def _to_measure(
    scene: Scene | None, seconds: float, rates: tuple[float, ...], transport: TransportKind, realtime: bool
) -> tuple[Scene, tuple[float, ...], list[Trial]]:
    """Returns (the scene to examine, the rates, in order, the runs). Raises UsageError."""
    if realtime:
        require_linux("--realtime", "leave it out")
    if transport == "loopback":
        raise UsageError("--transport: found loopback, which has no time of its own; expected terminal, or nothing")
    if scene is None:
        from hapsim.scene.shipped import shipped_scene

        scene = parse_scene(shipped_scene(_SHIPPED), _SHIPPED)
    for rate in rates:
        require_measurable(rate, seconds)
    require_measurable(scene.rate, seconds, f"{scene.path or 'the scene'}: rate")
    rates = tuple(sorted({*rates, scene.rate}))
    return scene, rates, trials(scene, rates, transport)


def _measure(
    rates: tuple[float, ...],
    to_run: list[Trial],
    seconds: float,
    realtime: bool,
    run: Run,
    report: Callable[[Step], None],
) -> tuple[dict[float, Histogram], list[PrivilegeResult], list[Exchanges]]:
    """Returns (wake-up latencies by rate, the newest grants, runs), some of them if it is interrupted. Raises
    KeyboardInterrupt before the first result."""
    steps, numbers = len(rates) + len(to_run), itertools.count(1)

    def begin(what: str) -> OnProgress:
        number = next(numbers)
        return lambda elapsed, compiling: report(Step(number, steps, what, elapsed, seconds, compiling))

    wakeups: dict[float, Histogram] = {}
    grants: list[list[PrivilegeResult]] = [[]]
    made: list[Exchanges] = []
    with contextlib.suppress(KeyboardInterrupt):
        for rate in rates:
            what = f"wake-ups at {frequency(rate)}"
            wakeups[rate] = wake_up_latency(rate, seconds, begin(what), realtime=realtime, on_grants=grants.append)
        for trial in to_run:
            made.append(exchanges(trial, seconds, begin(trial.in_words()), run, realtime=realtime))
    if not wakeups:
        raise KeyboardInterrupt
    return wakeups, grants[-1], made


def _ask(trial: Trial) -> None:
    """Asks a device on a port for its description, without arming it."""
    if trial.where == MOCK:
        return
    with open_connection(trial.scene, trial.transport) as connection:
        require_compatible(trial.scene, connection.name, describe(connection))


def _again(scene: Scene | None, where: str) -> str:
    """Returns the command that examines a scene (None: the shipped one) on this port, or on the mock, again."""
    words = ["hapsim", "doctor"]
    if scene is not None and scene.path is not None:
        words.append(scene.path)
        if where != MOCK:
            words += ["--port", where]
        elif scene.device.port is not None:
            words.append("--mock")
    return shlex.join(words)
