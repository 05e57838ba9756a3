"""Runs of a scene at one rate: what share of its forces this machine gets out in time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hapsim.device.open_connection import TransportKind
from hapsim.doctor.step import Tell
from hapsim.errors import RunError, UsageError
from hapsim.loop.histogram import Histogram
from hapsim.progress import Progress
from hapsim.scene import Clock, Scene

if TYPE_CHECKING:
    from hapsim.recording.trace import Report, Trace

Run = Callable[..., "Trace"]
"""hapsim.run, or what stands for it in a test."""

MOCK = "mock"
_NO_FORCE = 1e-12  # N: less than one count of any device, so that the limit cuts every force to zero


@dataclass(frozen=True)
class Trial:
    """A run that is to be made."""

    scene: Scene
    transport: TransportKind

    @property
    def where(self) -> str:
        """The port of the device, or "mock"."""
        return self.scene.device.port if self.transport == "auto" and self.scene.device.port else MOCK


@dataclass(frozen=True)
class Exchanges:
    """A run that was made, or one that failed."""

    rate_hz: float
    clock: Clock
    where: str
    """The port of the device, or "mock"."""
    report: Report | None
    """None where nothing was recorded."""
    lateness: Histogram | None
    """s, of the loop's wake-ups."""
    exchange: Histogram | None
    """s, of the exchanges."""
    failure: str = ""
    """Why the run ended early, in a sentence."""
    exit_status: int = 0
    """What kind of failure, as hapsim/errors.py has it."""

    @property
    def share_in_time(self) -> float | None:
        """Which share (0 to 1) of the forces that were asked for came in time; None where nothing ran."""
        return None if self.report is None else share_in_time(self.report, device_asks=self.clock == "device")

    @property
    def share_of_rate(self) -> float | None:
        """Which share of the rate was kept: 0.9 where 900 positions a second came instead of 1000."""
        if self.report is None or not self.report.duration_s > 0.0:
            return None
        return self.report.rate_hz / self.report.nominal_rate_hz


def share_in_time(report: Report, *, device_asks: bool) -> float | None:
    """Which share (0 to 1) of a run's forces came in time; None of a run without a tick.

    A force that was late and one that answers a position which was lost are deadline misses. Where the host is the
    clock, neither are those that it was too slow to send at all: a loop that runs at 900 Hz instead of 1000 misses a
    tenth. Where the device asks (`device_asks`), a slow rate is the device's, and what it asks for is known from the
    numbers of its samples.
    """
    if report.ticks == 0:
        return None
    asked = report.ticks + report.lost_frames
    if not device_asks:
        asked = max(asked, 1 + round(report.duration_s * report.nominal_rate_hz))
    return max(report.ticks - report.deadline_misses, 0) / asked


def trials(scene: Scene, rates: tuple[float, ...], transport: TransportKind) -> list[Trial]:
    """The runs by which a scene is examined.

    With a device: one, as the scene says. With the mock: every rate, under either clock. UsageError where the scene
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
    """The scene without its links, and with a limit that lets no force through: a doctor never pushes a hand."""
    modules = type(scene.modules)(  # type: ignore[call-arg]
        {name: module for name, module in scene.modules.items() if name not in scene.links}
    )
    return _changed(scene, scene.rate, force_limit=_NO_FORCE).model_copy(update={"modules": modules})


def exchanges(trial: Trial, seconds: float, tell: Tell, run: Run, *, realtime: bool) -> Exchanges:
    """Makes one run. What fails while it runs is part of the answer; UsageError and SceneError are raised."""
    try:
        trace = run(
            trial.scene,
            duration=seconds,
            transport=trial.transport,
            keep=False,
            on_progress=lambda progress: _pass_on(progress, tell),
            realtime=realtime,
        )
    except RunError as error:
        return _exchanges(trial, error.trace, str(error), error.exit_status)
    return _exchanges(trial, trace, "", 0)


def _exchanges(trial: Trial, trace: Trace | None, failure: str, exit_status: int) -> Exchanges:
    return Exchanges(
        rate_hz=trial.scene.rate,
        clock=trial.scene.device.clock,
        where=trial.where,
        report=None if trace is None else trace.report,
        lateness=None if trace is None else trace.statistics.lateness,
        exchange=None if trace is None else trace.statistics.exchange,
        failure=failure,
        exit_status=exit_status,
    )


def _changed(scene: Scene, rate: float, **device: Any) -> Scene:
    return scene.model_copy(update={"rate": rate, "device": scene.device.model_copy(update=device)})


def _pass_on(progress: Progress, tell: Tell) -> None:
    tell(progress.elapsed_s, progress.text if progress.phase == "compiling" else "")
