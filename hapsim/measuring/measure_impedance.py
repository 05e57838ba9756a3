"""Exciting a device with multisines, one channel after the other, and identifying the impedances of its loop."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hapsim.device.open_connection import TransportKind
from hapsim.errors import HapsimError, UsageError
from hapsim.measuring.converters import Converters
from hapsim.measuring.impedance import LEAST_PERIODS, Impedance, impedance_of, settling
from hapsim.measuring.multisine import Floats, Lines, Periods, lines_for, multisine, periods_of
from hapsim.measuring.trace_quality import SeenRate, seen_rate
from hapsim.progress import Progress
from hapsim.recording.trace import Trace
from hapsim.running import PeriodicExcitation, run
from hapsim.scene import Ground, Scene, ViscoElastic
from hapsim.scene.load import SceneSource, as_scene
from hapsim.stopping import INTERRUPTED

SHARE_OF_LIMIT = 0.25
"""Of the force limit, that an excitation's peak has at most."""
TRAVEL_M = 0.001
"""That a device point moves at most, about: excitations are made smaller where it would move farther."""

STOPPED = "stopped"  # as a report says it

_PERIODS, _MORE = 14, 4  # so many times as many where what was before has hardly died away
_UNCERTAIN = 0.01  # of the device's impedance, in the median: then more periods are worth their time
_SOFT_PERIODS, _SOFT = 5, 0.125  # of the first excitation, which finds how far a force moves what
_FEW_COUNTS = 20.0  # of travel: the rounding is no longer like noise


@dataclass(frozen=True)
class MeasuredImpedance(Impedance):
    """What was measured, on which channels, and by what."""

    channels: tuple[int, ...] = ()
    """(C,) as the scene numbers them."""
    period_s: float = math.nan
    peak_force: tuple[float, ...] = ()
    """(C,) N, of each channel's excitation."""
    travel: tuple[float, ...] = ()
    """(C,) m, from one end to the other, of the channel that was excited."""
    lost_periods: int = 0
    """Periods that were left out because positions of them never came."""
    limited_samples: int = 0
    """Samples whose force was cut to its limit."""
    seen_rate: SeenRate | None = None
    """At which rate the device sampled, as its positions arrived; None where that does not tell."""
    stopped: bool = False
    """Whether a signal ended it early: the impedance is of the periods until then."""
    traces: tuple[Trace, ...] = field(default=(), repr=False, compare=False)
    """(C,) what it was read from."""


class StoppedError(HapsimError):
    """A signal ended the measurement before every channel was excited."""

    exit_status = INTERRUPTED

    def __init__(self, traces: list[Trace]) -> None:
        super().__init__("stopped before every channel was excited for long enough: no impedance was identified")
        self.traces = tuple(traces)


def measure_impedance(
    scene: SceneSource,
    *,
    duration: float | None = None,
    travel: float = TRAVEL_M,
    push: float | None = None,
    transport: TransportKind = "auto",
    on_progress: Callable[[Progress], None] | None = None,
    stop_on_signals: bool = False,
) -> MeasuredImpedance:
    """The driving-point impedances of `scene` at its device points, from 2 Hz to close below the Nyquist frequency.

    Each channel in turn is excited by a multisine that is added to the scene's force: softly at first, which tells how
    far each frequency moves it, then so that it moves by about `travel` (m) at most, with at most `push` N (None: a
    quarter of the force limit). `duration`: seconds of each channel's second excitation. Where something in the scene
    is not linear, the impedance is that about the motion to which it was excited.

    Raises what `hapsim.running.run` raises, and UsageError where too little moves, or too little was recorded.
    """
    scene = as_scene(scene)
    lines = lines_for(scene.rate)
    periods = _whole_periods(duration, lines)
    if not 0 < travel < math.inf:
        raise UsageError(f"travel: found {travel}, expected a finite number of metres above 0")
    if push is not None and not 0 < push < math.inf:
        raise UsageError(f"push: found {push:g}, expected a finite number of newton above 0")
    most = SHARE_OF_LIMIT * _force_limit(scene) if push is None else min(push, _force_limit(scene))
    channels = tuple(point.channel for point in scene.device_points.values())
    if not channels:
        raise UsageError("the scene has no device point: there is nothing at which an impedance could be measured")
    travel = min(travel, *(0.5 * (most - least) for least, most in scene.device.travels(scene.channels)))

    def excited(channel: int, forces: Floats, count: int) -> Trace:
        return run(
            scene,
            duration=count * lines.period_s,
            transport=transport,
            excitation=PeriodicExcitation(channel, forces),
            on_progress=on_progress,
            stop_on_signals=stop_on_signals,
        )

    def is_stopped(trace: Trace) -> bool:
        return bool(trace.report.ending == STOPPED)

    traces: list[Trace] = []
    experiments, peaks, moved = [], [], []
    stopped = False
    for channel in channels:
        answer = excited(channel, _soft_forces(scene, lines, channel, travel, most), _SOFT_PERIODS)
        if is_stopped(answer):
            raise StoppedError(traces)
        forces = _forces(lines, _periods(answer, lines, scene), channels.index(channel), travel, most)
        peaks.append(float(np.max(np.abs(forces))))
        trace = excited(channel, forces, periods)
        experiment = _periods(trace, lines, scene)
        stopped = is_stopped(trace)
        if stopped and (channel != channels[-1] or experiment.position.shape[0] < LEAST_PERIODS):
            raise StoppedError([*traces, trace])
        moved.append(_travel(trace, lines, channel, peaks[-1]))
        unsettled = settling(experiment, channels.index(channel)).scatter > _UNCERTAIN
        if duration is None and not stopped and unsettled:
            longer = excited(channel, forces, _MORE * periods)
            stopped = is_stopped(longer)
            if stopped and channel != channels[-1]:
                raise StoppedError([*traces, trace])
            if not stopped:
                trace, experiment = longer, _periods(longer, lines, scene)
        traces.append(trace)
        experiments.append(experiment)
    converters = Converters(scene.device.hold, scene.device.sampling)
    found = impedance_of(experiments, lines.frequency, scene.rate, scene.device.delay, converters)
    return MeasuredImpedance(
        **vars(found),
        channels=channels,
        period_s=lines.period_s,
        peak_force=tuple(peaks),
        travel=tuple(moved),
        lost_periods=sum(one.lost for one in experiments),
        limited_samples=sum(one.limited for one in experiments),
        seen_rate=seen_rate(traces[0]),
        stopped=stopped,
        traces=tuple(traces),
    )


def _whole_periods(duration: float | None, lines: Lines) -> int:
    """How many periods of the excitation there are in so many seconds; enough of them for None."""
    if duration is None:
        return _PERIODS
    if not 0 < duration < math.inf:
        raise UsageError(f"duration: found {duration}, expected a finite number of seconds above 0")
    periods, fewest = math.floor(duration / lines.period_s * (1.0 + 1e-9)), LEAST_PERIODS + 2
    if periods < fewest:
        raise UsageError(
            f"duration: found {duration:g} s, expected {fewest * lines.period_s:g} s or more: {fewest} periods of the "
            "excitation"
        )
    return periods


def _periods(trace: Trace, lines: Lines, scene: Scene) -> Periods:
    """Of the scene's channels alone, in its order."""
    channels = [point.channel for point in scene.device_points.values()]
    if not np.all(np.isfinite(trace.asked_force)):
        raise UsageError("the scene's force was not finite throughout: there is nothing to be measured")
    converters = Converters(scene.device.hold, scene.device.sampling)
    return periods_of(trace, lines, converters, senses=bool(scene.sensed_links)).on(channels)


def _force_limit(scene: Scene) -> float:
    """N, of the scene and of the mock where that is the device."""
    limit = scene.device.force_limit
    return limit if scene.device.port is not None else min(limit, scene.mock_device.force_limit)


def _soft_forces(scene: Scene, lines: Lines, channel: int, travel: float, most: float) -> Floats:
    """By what the device's mass alone would do: what holds it is not known yet."""
    inertia = scene.device.masses(scene.channels)[channel] * (2.0 * np.pi * lines.frequency) ** 2
    amplitude = np.minimum(lines.each(most), lines.each(0.5 * travel) * inertia)
    return multisine(lines, _SOFT * amplitude, _SOFT * most)


def _forces(lines: Lines, answer: Periods, excited: int, travel: float, most: float) -> Floats:
    """As strong at each frequency as the travel, and the force, allow: from what the soft excitation moved."""
    if answer.position.shape[0] == 0:
        raise UsageError(
            "no period of the first excitation was recorded whole: positions are lost; `hapsim doctor` tells which "
            "rates are kept"
        )
    last = answer.after(max(0, answer.position.shape[0] - 3))
    force = np.abs(np.mean(last.force - last.scene, axis=0)[:, excited])
    position = np.max(np.abs(np.mean(last.position, axis=0)), axis=1)
    with np.errstate(divide="ignore"):
        amplitude = np.minimum(lines.each(most), lines.each(0.5 * travel) * force / position)
    return multisine(lines, amplitude, most)


def _travel(trace: Trace, lines: Lines, channel: int, peak: float) -> float:
    """m, from one end to the other in the last period. UsageError where that is next to nothing."""
    counts = trace.position_counts[-lines.samples :, channel].astype(float)
    moved, count = float(np.ptp(counts)) if counts.size else 0.0, float(trace.position_scale[channel])
    if moved < _FEW_COUNTS:
        raise UsageError(
            f"channel {channel}: an excitation of {peak:.3g} N at most moved it by {moved:g} counts of {count:g} m, "
            f"expected {_FEW_COUNTS:g} counts or more: the rounding hides its motion. Allow more force (force_limit; a "
            "quarter of it is used), or more travel, or use a finer position sensor"
        )
    return moved * count


def walls_in_place(scene: Scene, walls: Mapping[int, tuple[float, float]]) -> Scene:
    """The device of `scene` with a wall on each of these channels, (N/m, N·s/m), in place of all that the scene has."""
    modules: dict[str, Any] = dict(scene.device_points)
    for name, point in scene.device_points.items():
        if point.channel in walls:
            stiffness, damping = walls[point.channel]
            ends = (name, f"{name}-ground")
            modules[ends[1]] = Ground(type="ground")
            modules[f"{name}-wall"] = ViscoElastic(
                type="viscoelastic", between=ends, stiffness=stiffness, damping=damping
            )
    return scene.model_copy(update={"modules": modules})
