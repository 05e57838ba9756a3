"""Exciting a device with multisines, one channel after the other, and identifying the impedances of its loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple, Unpack

import numpy as np

from hapsim.errors import HapsimError, UsageError
from hapsim.loop.endings import IN_WORDS, STOPPED
from hapsim.measuring.converters import Converters, Floats
from hapsim.measuring.measurement_options import Run, RunOptions, largest_push, require_above_zero
from hapsim.measuring.periodic_excitation import (
    LEAST_PERIODS,
    Impedance,
    Lines,
    Periods,
    impedance_of,
    lines_for,
    multisine,
    periods_of,
    settling,
)
from hapsim.measuring.trace_quality import SeenRate, seen_rate, silence
from hapsim.recording.trace import Trace
from hapsim.running import PeriodicExcitation
from hapsim.running.run import run_to_end
from hapsim.scene import Ground, Scene, ViscoElastic
from hapsim.scene.load import SceneSource, as_scene
from hapsim.stopping import INTERRUPTED
from hapsim.units import Units

_PERIODS, _MORE = 14, 4  # times as many if the earlier motion has hardly died away
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
    """Periods that do not count because positions of them never came."""
    limited_samples: int = 0
    """Samples whose force was clipped at its limit."""
    seen_rate: SeenRate | None = None
    """At which rate the device sampled, as its positions arrived; None where that does not tell."""
    stopped: bool = False
    """Whether a signal ended it early: the impedance is of the periods until then."""
    traces: tuple[Trace, ...] = field(default=(), repr=False, compare=False)
    """(C,), the sources."""


class StoppedError(HapsimError):
    """A signal ended the measurement before every channel was excited."""

    exit_status = INTERRUPTED

    def __init__(self, runs: list[_Run], enough_s: float) -> None:
        """`enough_s`: the least time in which every channel is excited for long enough."""
        super().__init__(
            "stopped before every channel was excited for long enough: no impedance was identified; with these options "
            f"about {enough_s:.2g} s of running are enough"
        )
        self.traces = tuple(one.trace for one in runs)


class _Run(NamedTuple):
    """One excitation of one channel, and its record."""

    trace: Trace
    periods: Periods
    stopped: bool
    peak_force: float  # N
    travel: float = math.nan  # m, from one end to the other


def measure_impedance(
    scene: SceneSource,
    *,
    duration: float | None = None,
    travel: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> MeasuredImpedance:
    """The driving-point impedances of `scene` at its device points, from 2 Hz to close below the Nyquist frequency.

    Each channel in turn is excited by a multisine that is added to the scene's force: softly at first, which shows how
    far each frequency moves it, then so that it moves by about `travel` (m; None: 1 mm or 0.05 rad) at most, with at
    most `push` N (None: a quarter of the force limit). `duration`: seconds of each channel's second excitation. Where
    something in the scene is not linear, the impedance is that about the motion to which it was excited.

    `options`: `transport`, `on_progress`, `stop_on_signals` and `unstable`, as of `hapsim.run`; `run` is what they go
    to, with the scene. Raises what `hapsim.running.run` raises, and
    UsageError where too little moves, or too little was recorded.
    """
    scene, run = as_scene(scene), partial(run, **options)
    lines = lines_for(scene.rate)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units.name("metres"), travel=travel)
    require_above_zero(scene.units.name("newton"), push=push)
    periods = _PERIODS if duration is None else math.floor(duration / lines.period_s * (1.0 + 1e-9))
    if duration is not None and periods < (fewest := LEAST_PERIODS + 2):
        raise UsageError(
            f"duration: found {duration:g} s, expected {fewest * lines.period_s:g} s or more: {fewest} periods of the "
            "excitation"
        )
    rig = _Rig(run, scene, lines, travel, push)
    done = _excite_each(rig, periods, may_repeat=duration is None)
    found = impedance_of([one.periods for one in done], lines.frequency, scene.rate, scene.device.delay, rig.converters)
    return MeasuredImpedance(
        **vars(found),
        channels=rig.channels,
        period_s=lines.period_s,
        peak_force=tuple(one.peak_force for one in done),
        travel=tuple(one.travel for one in done),
        lost_periods=sum(one.periods.lost for one in done),
        limited_samples=sum(one.periods.limited for one in done),
        seen_rate=seen_rate(done[0].trace),
        stopped=done[-1].stopped,
        traces=tuple(one.trace for one in done),
    )


class _Rig:
    """A scene to excite, and by how much: at most `travel` (m; None: as usual) and `push` (N; None: a share of it).

    `run(scene, duration=…, excitation=…)` runs it.
    """

    def __init__(self, run: Run, scene: Scene, lines: Lines, travel: float | None, push: float | None) -> None:
        self.channels = tuple(point.channel for point in scene.device_points.values())
        if not self.channels:
            raise UsageError("the scene has no device point: there is nothing at which an impedance could be measured")
        self.lines, self.converters = lines, Converters(scene.device.hold, scene.device.sampling)
        self._most = largest_push(scene, push)
        usual = [one.excited if travel is None else travel for one in scene.device.scales(scene.channels)]
        rooms = [0.5 * (most - least) for least, most in scene.device.travels(scene.channels)]
        self.travel = np.minimum(usual, min(rooms))
        self._run, self.scene = run, scene

    def excite(self, channel: int, forces: Floats, count: int) -> _Run:
        """Runs `count` periods of these forces (N, of one period) on a channel."""
        pushes = PeriodicExcitation(channel, forces)
        trace = self._run(self.scene, duration=count * self.lines.period_s, excitation=pushes)
        if not np.all(np.isfinite(trace.asked_force)):
            raise UsageError("the scene's force was not finite throughout: there is nothing to be measured")
        periods = periods_of(trace, self.lines, self.converters, senses=bool(self.scene.sensed_links))
        stopped = trace.report.ending == IN_WORDS[STOPPED]
        return _Run(trace, periods.on(list(self.channels)), stopped, float(np.max(np.abs(forces))))

    def soft_forces(self, channel: int, share: float = _SOFT) -> Floats:
        """By what the device's mass alone would do, as what holds it is not known yet: a share of what it may have."""
        lines, most = self.lines, self._most
        inertia = self.scene.device.masses(self.scene.channels)[channel] * (2.0 * np.pi * lines.frequency) ** 2
        amplitude = np.minimum(lines.each(most), lines.each(0.5 * self.travel[channel]) * inertia)
        return multisine(lines, share * amplitude, share * most)

    def forces(self, answer: Periods, excited: int) -> Floats:
        """As strong at each frequency as the travel, and the force, allow: from what the soft excitation moved."""
        if answer.pairs == 0:
            raise UsageError(
                "no period of the first excitation was recorded whole: positions are lost; `hapsim doctor` shows which "
                "rates are kept"
            )
        lines, last = self.lines, answer.after(max(0, answer.pairs - 3))
        force = np.abs(np.mean(last.force - last.scene, axis=0)[:, excited])
        position = np.max(np.abs(np.mean(last.position, axis=0)), axis=1)
        with np.errstate(divide="ignore"):
            amplitude = np.minimum(
                lines.each(self._most), lines.each(0.5 * self.travel[self.channels[excited]]) * force / position
            )
        return multisine(lines, amplitude, self._most)


def _excite_each(rig: _Rig, periods: int, may_repeat: bool) -> list[_Run]:
    """Excites each channel, softly and then in full; for longer if that is worth its time and `may_repeat`.

    Raises StoppedError if a signal comes before the last channel was excited for long enough.
    """
    # Before the last channel all are excited in full; of the last one a stop leaves what was recorded.
    needed = len(rig.channels) * _SOFT_PERIODS + (len(rig.channels) - 1) * periods + LEAST_PERIODS + 2
    enough_s = needed * rig.lines.period_s
    done: list[_Run] = []
    for place, channel in enumerate(rig.channels):
        soft = rig.excite(channel, rig.soft_forces(channel), _SOFT_PERIODS)
        if soft.stopped:
            raise StoppedError(done, enough_s)
        said = silence(soft.trace, channel)
        # where the soft forces move the mass alone by clearly more than a count
        if said and 0.5 * _SOFT * rig.travel[channel] > _FEW_COUNTS * soft.trace.position_scale[channel]:
            raise UsageError(said)
        forces = rig.soft_forces(channel, share=1.0) if said else rig.forces(soft.periods, place)
        one, is_last = rig.excite(channel, forces, periods), channel == rig.channels[-1]
        if said := silence(one.trace, channel):
            raise UsageError(said)
        if one.stopped and not (is_last and one.periods.pairs >= LEAST_PERIODS):
            raise StoppedError([*done, one], enough_s)
        travel = _travel(one.trace, rig.lines, channel, one.peak_force, rig.scene.units_of(channel))
        if may_repeat and not one.stopped and settling(one.periods, place)[1] > _UNCERTAIN:
            longer = rig.excite(channel, forces, _MORE * periods)
            if longer.stopped and not is_last:
                raise StoppedError([*done, one], enough_s)
            one = one._replace(stopped=True) if longer.stopped else longer
        done.append(one._replace(travel=travel))
    return done


def _travel(trace: Trace, lines: Lines, channel: int, peak: float, units: Units) -> float:
    """m, from one end to the other in the last period. UsageError where that is next to nothing."""
    counts = trace.position_counts[-lines.samples :, channel].astype(float)
    moved, count = float(np.ptp(counts)) if counts.size else 0.0, float(trace.position_scale[channel])
    if moved < _FEW_COUNTS:
        raise UsageError(
            f"channel {channel}: an excitation of {units(peak, 'N', '.3g')} at most moved it by {moved:g} counts of "
            f"{units(count, 'm', 'g')}, "
            f"expected {_FEW_COUNTS:g} counts or more: the rounding hides its motion. Allow more force (force_limit; a "
            "quarter of it is used), or more travel, or use a finer position sensor"
        )
    return moved * count


def walls_in_place(scene: Scene, walls: Mapping[int, tuple[float, float]]) -> Scene:
    """The device of `scene` with a wall on each of these channels, (N/m, N·s/m), in place of all that the scene has."""
    modules: dict[str, Any] = dict(scene.device_points)
    for name, point in scene.device_points.items():
        if point.channel in walls:
            ends, (K, B) = (name, f"{name}-ground"), walls[point.channel]
            modules[ends[1]] = Ground(type="ground")
            modules[f"{name}-wall"] = ViscoElastic(type="viscoelastic", between=ends, stiffness=K, damping=B)
    return scene.model_copy(update={"modules": modules})
