"""measure_impedance: excites each channel of a device with a multisine, and identifies the impedances of its loop."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
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
from hapsim.running.motors import as_limited
from hapsim.running.run import run_to_end
from hapsim.scene import Ground, Scene, ViscoElastic
from hapsim.scene.input_states import with_mock_inputs_on
from hapsim.scene.load import SceneSource, as_scene
from hapsim.stopping import INTERRUPTED
from hapsim.units import Units

_PERIODS, _MORE = 14, 4  # the second: times as many if earlier motion has not decayed
_UNCERTAIN = 0.01  # median relative uncertainty of the device's impedance: above it more periods are recorded
_SOFT_PERIODS, _SOFT = 5, 0.125  # of the first excitation, which finds how far a force moves each channel
_FEW_COUNTS = 20.0  # of travel: with fewer, rounding is no longer like noise


@dataclass(frozen=True)
class MeasuredImpedance(Impedance):
    """The measured impedances of C channels, and how they were measured."""

    channels: tuple[int, ...] = ()
    """Channel numbers as in the scene, (C,)."""
    period_s: float = math.nan
    peak_force: tuple[float, ...] = ()
    """Peak force of each channel's excitation, (C,) N."""
    travel: tuple[float, ...] = ()
    """Peak-to-peak motion of each channel under its excitation, (C,) m."""
    lost_periods: int = 0
    """Number of ignored periods, of which positions were lost."""
    limited_samples: int = 0
    """Number of samples whose force was clipped at its limit."""
    seen_rate: SeenRate | None = None
    """Rate at which the device sampled, from the arrival of its positions; None if they do not show it."""
    stopped: bool = False
    """True if a signal ended the measurement early; the impedance is of the periods until then."""
    traces: tuple[Trace, ...] = field(default=(), repr=False, compare=False)
    """The records, (C,)."""


class StoppedError(HapsimError):
    """A signal ended the measurement before every channel was excited."""

    exit_status = INTERRUPTED

    def __init__(self, runs: list[_Run], enough_s: float) -> None:
        """Makes the error. `enough_s`: the time after which every channel has been excited for long enough, s."""
        super().__init__(
            "stopped before every channel was excited for long enough: no impedance was identified. With these options "
            f"the measurement needs about {enough_s:.2g} s"
        )
        self.traces = tuple(one.trace for one in runs)


class _Run(NamedTuple):
    """One excitation of one channel, and its record."""

    trace: Trace
    periods: Periods
    stopped: bool
    peak_force: float  # N
    travel: float = math.nan  # m, peak to peak


def measure_impedance(
    scene: SceneSource,
    *,
    duration: float | None = None,
    travel: float | None = None,
    push: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> MeasuredImpedance:
    """Measures the driving-point impedances of `scene` at its device points, from 2 Hz to just below Nyquist's limit.

    A multisine added to the scene's force excites each channel in turn: softly at first, which shows how far each
    frequency moves it, then in full. The full motion is at most about `travel` m (None: 1 mm or 0.05 rad), the force at
    most `push` N (None: a quarter of the force limit). `duration`: seconds of each channel's full excitation. The
    impedance of a nonlinear scene is that for the excited motion.

    `run` runs the scene, with `options`: `transport`, `on_progress`, `stop_on_signals` and `unstable` of `hapsim.run`.
    Raises the errors of `run`, and UsageError if too little moves or too little was recorded.
    """
    scene = with_mock_inputs_on(as_scene(scene))
    scene.require_impedance("`measure_impedance` excites the handle with forces; `measure` finds mass and damping")
    if scene.device.law == "board":
        raise UsageError(
            "device.law: found board, expected host: the force between two samples, of which an impedance is made, is "
            "not measured; measure without --impedance finds k and b"
        )
    lines = lines_for(scene.rate)
    require_above_zero("seconds", duration=duration)
    require_above_zero(scene.units.name("metres"), travel=travel)
    require_above_zero(scene.units.name("newton"), push=push)
    periods = _PERIODS if duration is None else math.floor(duration / lines.period_s * (1.0 + 1e-9))
    if duration is not None and periods < (fewest := LEAST_PERIODS + 2):
        raise UsageError(
            f"duration: found {duration:g} s, expected at least {fewest * lines.period_s:g} s ({fewest} periods of the "
            "excitation)"
        )
    scene, run = as_limited(scene, range(scene.channels), push, run, options)
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
    """The scene to excite, and the limits of the excitation: `travel` (m or None) and `push` (N or None).

    `run(scene, duration=…, excitation=…)` runs it.
    """

    def __init__(self, run: Run, scene: Scene, lines: Lines, travel: float | None, push: float | None) -> None:
        self.channels = tuple(point.channel for point in scene.device_points.values())
        if not self.channels:
            raise UsageError("the scene has no device point, so no impedance can be measured")
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
            raise UsageError("the scene's force was not always finite: nothing was measured")
        periods = periods_of(trace, self.lines, self.converters, senses=bool(self.scene.sensed_links))
        stopped = trace.report.ending == IN_WORDS[STOPPED]
        return _Run(trace, periods.on(list(self.channels)), stopped, float(np.max(np.abs(forces))))

    def soft_forces(self, channel: int, share: float = _SOFT) -> Floats:
        """Returns a period of the soft excitation (N): `share` of the force that would move the device's mass alone to
        the limits. What holds the device is not known yet."""
        lines, most = self.lines, self._most
        inertia = self.scene.device.masses(self.scene.channels)[channel] * (2.0 * np.pi * lines.frequency) ** 2
        amplitude = np.minimum(lines.each(most), lines.each(0.5 * self.travel[channel]) * inertia)
        return multisine(lines, share * amplitude, share * most)

    def forces(self, answer: Periods, excited: int) -> Floats:
        """Returns a period of the full excitation (N), as strong at each frequency as travel and force allow, from the
        motion under the soft one."""
        if answer.pairs == 0:
            raise UsageError(
                "no period of the first excitation was recorded completely: positions are lost. `hapsim doctor` shows "
                "which rates can be kept"
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
    """Excites each channel, softly and then in full; for longer if the result is uncertain and `may_repeat`.

    Raises StoppedError if a signal comes before the last channel was excited for long enough.
    """
    # A stop may shorten the record of the last channel only.
    needed = len(rig.channels) * _SOFT_PERIODS + (len(rig.channels) - 1) * periods + LEAST_PERIODS + 2
    enough_s = needed * rig.lines.period_s
    done: list[_Run] = []
    for place, channel in enumerate(rig.channels):
        soft = rig.excite(channel, rig.soft_forces(channel), _SOFT_PERIODS)
        if soft.stopped:
            raise StoppedError(done, enough_s)
        reason = silence(soft.trace, channel)
        # an error only if the soft forces would move the mass alone by clearly more than a count
        if reason and 0.5 * _SOFT * rig.travel[channel] > _FEW_COUNTS * soft.trace.position_scale[channel]:
            raise UsageError(reason)
        forces = rig.soft_forces(channel, share=1.0) if reason else rig.forces(soft.periods, place)
        one, is_last = rig.excite(channel, forces, periods), channel == rig.channels[-1]
        if reason := silence(one.trace, channel):
            raise UsageError(reason)
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
    """Returns the peak-to-peak motion in the last period, m. Raises UsageError if it is only some counts."""
    counts = trace.position_counts[-lines.samples :, channel].astype(float)
    moved, count = float(np.ptp(counts)) if counts.size else 0.0, float(trace.position_scale[channel])
    if moved < _FEW_COUNTS:
        raise UsageError(
            f"channel {channel}: an excitation of up to {units(peak, 'N', '.3g')} moved it by {moved:g} counts of "
            f"{units(count, 'm', 'g')}, expected at least {_FEW_COUNTS:g}: rounding hides the motion. Allow more force "
            "(a quarter of force_limit is used) or more travel, or use a finer position sensor"
        )
    return moved * count


def walls_in_place(scene: Scene, walls: Mapping[int, tuple[float, float]]) -> Scene:
    """Returns the device of `scene` with a wall (N/m, N·s/m) on each of these channels, without the scene's modules."""
    modules: dict[str, Any] = dict(scene.device_points)
    for name, point in scene.device_points.items():
        if point.channel in walls:
            ends, (K, B) = (name, f"{name}-ground"), walls[point.channel]
            modules[ends[1]] = Ground(type="ground")
            modules[f"{name}-wall"] = ViscoElastic(type="viscoelastic", between=ends, stiffness=K, damping=B)
    return scene.model_copy(update={"modules": modules})
