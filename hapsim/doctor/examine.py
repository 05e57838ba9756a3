"""The examination: wake-ups and exchanges, rate after rate, and what they come to."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from hapsim.device.conversation import describe
from hapsim.device.open_connection import TransportKind, open_connection
from hapsim.doctor.advice import Advice, Situation, advice_on
from hapsim.doctor.exchanges import MOCK, Exchanges, Run, Trial, Verdict, best_rate, exchanges, trials, verdict_on
from hapsim.doctor.machine import Load, Machine, SystemFiles, cpu_times, load_between, machine_of
from hapsim.doctor.wakeups import Tell, require_measurable, wake_up_latency
from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.loop.system import require_linux
from hapsim.number_format import frequency
from hapsim.running.requirements import require_compatible
from hapsim.scene import Scene, parse_scene

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult

RATES_HZ = (1000.0, 2000.0, 4000.0, 10000.0)
_SHIPPED = "first_touch.yaml"


@dataclass(frozen=True)
class Step:
    """One measurement of an examination."""

    number: int
    """From 1 on."""
    of: int
    what: str
    """In words: wake-ups at 4 kHz."""
    elapsed_s: float
    seconds: float
    """How long it takes in all."""
    compiling: str
    """The function that is being compiled before it begins, or ""."""


@dataclass(frozen=True)
class Examination:
    """What a machine was found to be, and to keep up with."""

    scene: str
    """The file of the scene that ran."""
    rate_hz: float
    """The scene's own."""
    seconds: float
    """How long each measurement took."""
    machine: Machine
    grants: tuple[PrivilegeResult, ...] | None
    """What was asked for of real time; None where nothing was."""
    wakeups: dict[float, Histogram]
    """By rate (Hz): the wake-up latencies (s) of a thread."""
    exchanges: tuple[Exchanges, ...]
    verdicts: tuple[Verdict, ...]
    """One for each of `exchanges`."""
    load: Load | None
    advice: tuple[Advice, ...]
    steps: int = 0
    """How many measurements it is made of."""
    stopped_after: int | None = None
    """How many of them were made when an interrupt ended it; None where it was not interrupted."""

    @property
    def stopped(self) -> str:
        """That it was interrupted, in a sentence; "" where it was not."""
        if self.stopped_after is None:
            return ""
        return f"stopped after {self.stopped_after} of {self.steps} steps: the measurements until then are shown"

    @property
    def best_rates(self) -> dict[str, float | None]:
        """By clock: the fastest rate (Hz) that this machine keeps on the mock; empty where a device was examined."""
        clocks = dict.fromkeys(verdict.clock for verdict in self.verdicts if verdict.where == MOCK)
        return {clock: best_rate(self.verdicts, clock) for clock in clocks}

    @property
    def device_failed(self) -> Exchanges | None:
        """The run whose device, on a port, failed; None where none did."""
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
    """How steady this machine is for a haptic loop.

    First a thread sleeps to a grid of each of `rates` (Hz), and of the scene's own, and its wake-up latencies are
    counted. Then `scene` (None: the shipped first_touch) runs: on its device where it names a port and `transport` is
    "auto", at its own rate, and sent no force but zero; otherwise on the mock, at every rate and under either clock.
    Each of these takes `seconds`. `realtime`: with what this user may have of real time. `tree`, `run`, `ask`: in
    place of this system's files, of hapsim.run and of asking the device, for tests.

    A run that fails is part of the answer, and so is what was measured before a KeyboardInterrupt; one that comes
    before the first measurement was made is passed on. Raises, before anything is measured, UsageError for rates and
    times that cannot be, and where a scene and its device do not go together; DeviceError where no device answers.
    """
    if transport == "loopback":
        raise UsageError("--transport: found loopback, which has no time of its own; expected terminal, or nothing")
    require_linux("hapsim doctor, which examines the compiled loop,", "`hapsim run --portable` tells its own lateness")
    examined, tree = scene or _shipped(), tree or SystemFiles()
    _require_measurable(examined, rates, seconds)
    rates = tuple(sorted({*rates, examined.rate}))
    to_run = trials(examined, rates, transport)
    (ask or _ask)(to_run[0])
    steps = _Steps(len(rates) + len(to_run), seconds, on_progress)
    before = cpu_times(tree)
    wakeups: dict[float, Histogram] = {}
    granted: list[list[PrivilegeResult]] = []
    made: list[Exchanges] = []
    stopped = False
    try:
        _measure_wakeups(rates, seconds, steps, realtime, wakeups, granted)
        _make_exchanges(to_run, seconds, steps, run or _hapsim_run(), realtime, made)
    except KeyboardInterrupt:
        if not wakeups:
            raise
        stopped = True
    ran, grants = tuple(made), tuple(granted[-1]) if realtime else None
    machine = machine_of(tree)
    load = load_between(before, cpu_times(tree), machine.cores_online, tree)
    verdicts = tuple(map(verdict_on, ran))
    case = Situation(
        tree=tree,
        machine=machine,
        port=examined.device.port if to_run[0].where != MOCK else None,
        grants=grants,
        worst_wakeup_s=max(histogram.maximum for histogram in wakeups.values()),
        keeps_up=all(verdict.answer == "yes" for verdict in verdicts),
        load=load,
        again=_again(scene, to_run[0].where),
    )
    return Examination(
        scene=examined.path or _SHIPPED,
        rate_hz=examined.rate,
        seconds=seconds,
        machine=machine,
        grants=grants,
        wakeups=wakeups,
        exchanges=ran,
        verdicts=verdicts,
        load=load,
        advice=tuple(advice_on(case)),
        steps=steps.of,
        stopped_after=len(wakeups) + len(ran) if stopped else None,
    )


def _ask(trial: Trial) -> None:
    """Asks a device on a port what it is: it is not armed."""
    if trial.where == MOCK:
        return
    with open_connection(trial.scene, trial.transport) as connection:
        require_compatible(trial.scene, connection.name, describe(connection))


def _require_measurable(scene: Scene, rates: tuple[float, ...], seconds: float) -> None:
    for rate in rates:
        require_measurable(rate, seconds)
    require_measurable(scene.rate, seconds, f"{scene.path or 'the scene'}: rate")


def _measure_wakeups(
    rates: tuple[float, ...],
    seconds: float,
    steps: _Steps,
    realtime: bool,
    wakeups: dict[float, Histogram],
    granted: list[list[PrivilegeResult]],
) -> None:
    """Adds the wake-up latencies of a thread to `wakeups`, rate by rate, and what it was granted to `granted`."""
    for rate in rates:
        tell = steps.next(f"wake-ups at {frequency(rate)}")
        wakeups[rate] = wake_up_latency(rate, seconds, tell, realtime=realtime, on_grants=granted.append)


def _make_exchanges(
    to_run: Sequence[Trial], seconds: float, steps: _Steps, run: Run, realtime: bool, made: list[Exchanges]
) -> None:
    """Adds what came of each to `made`, in their order."""
    for one in to_run:
        made.append(exchanges(one, seconds, steps.next(_named(one)), run, realtime=realtime))


class _Steps:
    """Counts measurements, and tells how far each is."""

    def __init__(self, of: int, seconds: float, tell: Callable[[Step], None] | None) -> None:
        self.of, self._seconds, self._number = of, seconds, 0
        self._tell = tell or (lambda _: None)

    def next(self, what: str) -> Tell:
        """Begins a measurement; returns what to report progress to."""
        self._number += 1
        number = self._number
        return lambda elapsed, compiling: self._tell(Step(number, self.of, what, elapsed, self._seconds, compiling))


def _again(scene: Scene | None, where: str) -> str:
    """What examines a scene (None: the shipped one) on this port, or on the mock, again: for a shell."""
    told = ["hapsim", "doctor"]
    if scene is not None and scene.path is not None:
        told.append(scene.path)
        if where != MOCK:
            told += ["--port", where]
        elif scene.device.port is not None:
            told.append("--mock")
    return shlex.join(told)


def _named(trial: Trial) -> str:
    where = "the mock" if trial.where == MOCK else trial.where
    return f"exchanges at {frequency(trial.scene.rate)}, clock: {trial.scene.device.clock}, on {where}"


def _shipped() -> Scene:
    from hapsim.scene.shipped import shipped_scene

    return parse_scene(shipped_scene(_SHIPPED), _SHIPPED)


def _hapsim_run() -> Run:
    from hapsim.running import run

    return run
