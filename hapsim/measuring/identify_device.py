"""Identification of a device: it is pushed within stated bounds, and mass, friction, stiffness and delay are fitted."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, Unpack

import numpy as np

from hapsim.errors import GuardError, UsageError
from hapsim.loop.endings import IN_WORDS, STOPPED
from hapsim.loop.guards import travel
from hapsim.measuring.converters import Converters
from hapsim.measuring.device_diagnosis import (
    LOUD,
    ForceResidual,
    Pushed,
    force_residual,
    inverted,
    misfit_of,
    why_not,
    why_too_far,
)
from hapsim.measuring.device_fit import DeviceFit, Shape, fit_device, hands_on
from hapsim.measuring.device_motion import (
    Bounds,
    Drive,
    Motion,
    Plant,
    Swing,
    drive_for,
    motion_of,
    peak_per_newton,
    pieces_of,
    scene_of,
    swings_of,
)
from hapsim.measuring.measurement_options import (
    SHARE_OF_LIMIT,
    Run,
    RunOptions,
    force_limit,
    require_above_zero,
    require_device_point,
)
from hapsim.measuring.trace_quality import ROUNDING, SeenRate, seen_rate, silence, silence_words
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.run import run_to_end
from hapsim.running.session_options import PeriodicExcitation
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene

SECONDS = 6.0
"""Default duration of the record that is fitted."""

_LISTEN_S, _LISTEN_TICKS = 0.1, 64
_GENTLE_HALVES, _GENTLE_TICKS = 12, 384
_MAY_BE_LIGHTER = 10.0  # the mass, than declared
_COUNTS_OF_DAMPING = 1.5  # steps of the damper's force, by a count of the position, that the gentlest push is at least
_FIRST_MOVES, _FIRST_TRAVEL = 0.07, 0.2  # of the travel, at first: wired the wrong way it runs away
_MOVES = 0.35  # of the travel: enough for a fit
_MEANT = 0.6  # of the travel
_UNSEEN, _UNSEEN_COUNTS = 0.07, 2.0
# Of the travel, and counts: how far a free mass as declared is moved, and back, until its position answers, so that one
# ten times lighter stays in its travel, too.
_HARDLY = 0.02  # of the travel
_A_LITTLE_HARDER, _MUCH_HARDER = 1.25, 3.0
_MOST_ATTEMPTS = 36  # from the gentlest push on
_MOST_RECORDINGS = 4  # of a device that a first fit describes
_MANY_TIMES_DECLARED, _LEAST_DELAY = 3.0, 8.0
_HAND_LEAVES = 0.3  # of what one mass leaves: two are seen
_UNSURE_HAND = 0.3  # of its mass: a hand that is none
_PIECE_S = 0.5  # a fit of two masses uses pieces of this length
_NOISE_PEAK = 4.0  # rms: how far the noise of a record reaches
_DELAY_STEP, _FRICTIONS, _STIFFNESSES = 2.0, (0.0, 1.0, 5.0, 20.0), (0.0, 3.0, 30.0)  # of a first fit, by swings
_DRIVES = ((1.0, 0.5), (0.6, 1.0), (1.6, 0.7))  # pace and tightness: three simulated (K, B)


@dataclass(frozen=True, kw_only=True)
class DeviceIdentification(DeviceFit):
    """What was found of a device on one channel, beside the values of `DeviceFit`. SI units."""

    noise_m: float
    """rms, of the positions at rest; their counts are in it."""
    channel: int
    bounds: Bounds
    """Within which it was pushed."""
    drives: tuple[Drive, ...]
    """At which simulated stiffness and damping, and how."""
    peak_m: float
    """How far it was moved, from where it was found."""
    rate_hz: float
    count_m: float
    """m per count of the position."""
    misfit: str
    """A sentence that says where the model does not fit; "" where it does."""
    stopped: bool
    """Whether a signal ended it early; the values are those of the record until then."""
    seen_rate: SeenRate | None
    """At which rate the device sampled, as its positions arrived; None where that does not tell."""
    motions: tuple[Motion, ...] = field(repr=False, compare=False)
    force_residual: ForceResidual = field(repr=False, compare=False)
    traces: tuple[Trace, ...] = field(repr=False, compare=False)

    @property
    def residual_m(self) -> float:
        """rms, of the positions: their rounding and noise where all is well."""
        return self.residual_counts * self.count_m


def bounds_of(scene: Scene, channel: int, force: float | None = None, travel: float | None = None) -> Bounds:
    """What the device may be given; defaults: a quarter of the scene's force limit, and 5 mm or 0.2 rad to either side.
    UsageError where more than the limit is asked for."""
    limit = force_limit(scene)
    require_device_point(scene, channel)
    units = scene.units_of(channel)
    if force is not None and not 0.0 < force <= limit:
        found, most = units(force, "N", "g"), units(limit, "N", "g")
        expected = f"expected above 0 {units.name('N')}, and at most the force_limit, {most}"
        raise UsageError(f"force: found {found}, {expected}")
    require_above_zero(units.name("metres"), travel=travel)
    travel = scene.device.scales(scene.channels)[channel].travel if travel is None else travel
    return Bounds(SHARE_OF_LIMIT * limit if force is None else force, travel)


def identify_device(
    scene: SceneSource,
    *,
    channel: int = 0,
    force: float | None = None,
    travel: float | None = None,
    duration: float | None = None,
    run: Run = run_to_end,
    **options: Unpack[RunOptions],
) -> DeviceIdentification:
    """Pushes the device of `scene` on `channel`, whatever the scene simulates, and identifies what it is.

    `force`: N, at most, to either side [default: a quarter of the scene's force_limit]. `travel`: m, at most, from
    where it is found [default: 0.005 m, 0.2 rad]. `duration`: seconds that are recorded for the fit, beside
    a few seconds that find out how hard to push. It begins with a fraction of the force that the declared mass would
    need, and pushes harder as it learns how far the device gets. Mass, friction and delay may be declared wrong by a
    factor of three.

    `options`: `transport`, `on_progress` and `stop_on_signals`, as of `hapsim.run`; `run` is what they go to, with the
    scene. Raises what `hapsim.running.run` raises, GuardError where the device moved farther than `travel`, and
    UsageError where too little moves to identify anything, or what moves does not answer to the force.
    """
    scene = as_scene(scene)
    require_device_point(scene, channel)
    require_above_zero("seconds", duration=duration)
    # unstable: the band in which the force fades may be narrow, and nothing is held there for long
    pusher = _Pusher(
        scene, channel, bounds_of(scene, channel, force, travel), partial(run, **{**options, "unstable": True})
    )
    with one_thread():
        pusher.find_home()
        rough = pusher.grow()
        pusher.record(rough, SECONDS if duration is None else duration)
        return pusher.identified(rough.shape)


class _Pusher:
    """A device that is pushed within bounds, run after run, and the records of it."""

    def __init__(self, scene: Scene, channel: int, bounds: Bounds, run: Run) -> None:
        self._scene, self._channel, self._bounds, self._run_scene = scene, channel, bounds, run
        self._converters = Converters(scene.device.hold, scene.device.sampling)
        self._most_delay = max(_LEAST_DELAY, _MANY_TIMES_DECLARED * scene.device.delay + 1.0)
        self._home_counts = self._noise_counts = 0.0
        self._count_m = 1.0
        self._records: list[tuple[Drive, Trace]] = []
        self._stopped = False
        """Whether a signal ended the last run."""
        self._judged = False
        """Whether a motion has shown which way the motor is wired."""

    def find_home(self) -> None:
        """Where the device stands at zero force, and how its positions are noisy there."""
        trace = self._run(None, self._bounds, max(_LISTEN_S, _LISTEN_TICKS / self._scene.rate))
        counts = trace.position_counts[:, self._channel].astype(float)
        self._count_m = float(trace.position_scale[self._channel])
        moved = float(np.ptp(counts)) * self._count_m if counts.size else 0.0
        if self._stopped or counts.size < _LISTEN_TICKS // 2:
            raise UsageError("stopped before the device was pushed: nothing was identified")
        if moved > self._bounds.travel:
            units = self._scene.units_of(self._channel)
            raise GuardError(
                f"without any force the device moved by {units(moved, 'mm', '.3g')}, farther than the "
                f"{units(self._bounds.travel, 'mm', 'g')} that it may: it was not pushed. Let it rest, or hold it, and "
                "try again (a mock moves by itself where the scene has mock.initial)"
            )
        self._home_counts = float(np.median(counts))
        self._noise_counts = float(np.std(np.diff(counts, 2))) / math.sqrt(6.0)

    def grow(self) -> DeviceFit:
        """Pushes ever harder until the device moves enough for a first fit."""
        scene, bounds = self._scene, self._bounds
        declared = Plant(scene.device.masses(scene.channels)[self._channel], 0.0, 0.0, scene.device.delay)
        full = drive_for(declared, bounds, scene.rate, pace=1.0, tightness=0.5)
        steepest = _MAY_BE_LIGHTER * peak_per_newton(declared, full, scene.rate, self._converters)
        force = _FIRST_MOVES * bounds.travel / steepest
        if scene.device.port is not None:  # whose guard ends a run that rounding shakes at the limit of its force
            clear = _COUNTS_OF_DAMPING * full.damping * scene.rate * self._count_m
            force = max(force, min(clear, 0.5 * _FIRST_TRAVEL * bounds.travel / (steepest / _MAY_BE_LIGHTER)))
        force = min(full.force, force)
        gentle = replace(full, force=self._answered(full, force))
        first_travel = _FIRST_TRAVEL if gentle.force == force else 1.0  # it had to be torn loose
        duration = max(_GENTLE_HALVES * full.half, _GENTLE_TICKS) / scene.rate
        drive, trace = self._far_enough(gentle, duration, steepest, first_travel * bounds.travel, _MOST_ATTEMPTS)
        if self._stopped:
            raise UsageError("stopped before enough was recorded: nothing was identified")
        return self._sound_fit(drive, trace, [trace])

    def _answered(self, drive: Drive, force: float) -> float:
        """Returns the force (N), from `force` on, at which a count of the position changes. UsageError where none does.

        Until then the position is no guide: a sensor may be dead. So each push is +F, -F, -F, +F, each so short that a
        free mass as declared gets no farther than F t²/m, and comes back to rest where it was."""
        device, travel, rate = self._scene.device, self._bounds.travel, self._scene.rate
        mass = device.masses(self._scene.channels)[self._channel]
        way = max(_UNSEEN * travel, min(_UNSEEN_COUNTS * self._count_m, _MOVES * travel))
        acted, most = 0.0, min(self._bounds.push, way * mass * rate**2)  # within a sample no push is shorter
        force = min(force, most)
        while True:
            ticks = max(min(math.floor(math.sqrt(way * mass / force) * rate), drive.half), 1)
            signs = np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], ticks)
            push = PeriodicExcitation(self._channel, force * signs)
            trace = self._run(replace(drive, force=force), self._bounds, (signs.size - 1) / rate, push)
            if self._stopped:
                raise UsageError("stopped before the device moved: nothing was identified")
            if np.ptp(trace.position_counts[:, self._channel]):
                return force
            acted += 4 * ticks / rate
            if force >= most:
                raise UsageError(silence_words(acted, force, self._scene.units_of(self._channel)))
            force = min(_A_LITTLE_HARDER * force, most)

    def record(self, rough: DeviceFit, duration: float) -> None:
        """Records the device at several simulated (K, B), as far as it may be moved; with which ones."""
        mass = rough.mass.value + (rough.hand.mass.value if rough.hand is not None else 0.0)
        plant = Plant(mass, *(max(one.value, 0.0) for one in (rough.friction, rough.stiffness, rough.delay)))
        piece = duration / len(_DRIVES)
        for pace, tightness in _DRIVES:
            drive = drive_for(plant, self._bounds, self._scene.rate, pace=pace, tightness=tightness)
            slope = peak_per_newton(plant, drive, self._scene.rate, self._converters)
            drive = replace(drive, force=min(drive.force, _MEANT * self._bounds.travel / slope))
            self._records.append(self._far_enough(drive, piece, slope, self._bounds.travel, _MOST_RECORDINGS))
            if self._stopped:
                return

    def _far_enough(
        self, drive: Drive, duration: float, slope: float, travel: float, attempts: int
    ) -> tuple[Drive, Trace]:
        """A run under this drive, or a stronger one if the device moves too little, after at most `attempts` runs.
        `slope`: m that it may move with each newton; `travel`: m that the first run may move it."""
        before: tuple[float, float] | None = None
        for _ in range(attempts):
            bounds, travel = replace(self._bounds, travel=travel), self._bounds.travel
            trace = self._pushed(drive, duration, bounds)
            if silence(trace, self._channel) and not self._stopped:
                force = self._answered(drive, min(_A_LITTLE_HARDER * drive.force, self._bounds.push))
                if drive.force < self._bounds.push:
                    drive = replace(drive, force=force)
                    continue
            peak = self._peak(trace)
            stuck = peak <= _HARDLY * travel
            if not (stuck or self._judged):
                self._judged = True
                if error := inverted(self._fit([trace]), self._seen(drive, trace, self._bounds)):
                    raise error
            if self._stopped or peak > _MOVES * travel or drive.force >= self._bounds.push:
                break
            slope = slope if before is None else (peak - before[1]) / (drive.force - before[0])
            before = None if stuck else (drive.force, peak)
            wanted = drive.force + max(_MEANT * travel - peak, 0.0) / max(slope, 1e-300)
            # Where it hardly moved a dry friction is in the way, or a large mass: then a quarter more at least.
            force = max(wanted, _A_LITTLE_HARDER * drive.force) if stuck else min(wanted, _MUCH_HARDER * drive.force)
            drive = replace(drive, force=min(self._bounds.push, force))
        return drive, trace

    def identified(self, start: Shape) -> DeviceIdentification:
        """The fit over all that was recorded, from `start` on."""
        rate, count_m, traces = self._scene.rate, self._count_m, [trace for _, trace in self._records]
        farthest = max(self._records, key=lambda record: self._peak(record[1]))
        fit = self._sound_fit(*farthest, traces, start)
        motions = self._motions(traces)
        lacking = force_residual(motions, fit, self._noise_counts, count_m, rate, self._converters)
        return DeviceIdentification(
            **vars(fit),
            noise_m=self._noise_counts * count_m,
            channel=self._channel,
            bounds=self._bounds,
            drives=tuple(drive for drive, _ in self._records),
            peak_m=self._peak(farthest[1]),
            rate_hz=rate,
            count_m=count_m,
            misfit=misfit_of(fit, lacking, self._noise_counts, self._scene.units_of(self._channel)),
            stopped=self._stopped,
            seen_rate=seen_rate(max(traces, key=lambda trace: trace.sample.size)),
            motions=tuple(motions),
            force_residual=lacking,
            traces=tuple(traces),
        )

    def _motions(self, traces: list[Trace]) -> list[Motion]:
        return [motion_of(trace, self._channel, self._home_counts, self._most_delay) for trace in traces]

    def _sound_fit(self, drive: Drive, trace: Trace, traces: list[Trace], begin: Shape = ()) -> DeviceFit:
        """The fit of `traces`; the error that a run under this drive shows where it is none to go on from."""
        fit = self._fit(traces, begin)
        error = why_not(fit, self._seen(drive, trace, self._bounds))
        if error is not None:
            raise error
        assert fit is not None
        return fit

    def _fit(self, traces: list[Trace], begin: Shape = ()) -> DeviceFit | None:
        """A mass; or two, where that leaves much less. From `begin` on, if there is one."""
        motions = self._motions(traces)
        swings, floor = swings_of(motions, self._noise_counts), math.hypot(self._noise_counts, ROUNDING)
        given: dict[str, Any] = {"count_m": self._count_m, "rate_hz": self._scene.rate, "most_delay": self._most_delay}
        fit = partial(fit_device, motions, converters=self._converters, **given)
        one = fit(swings=swings, begins=[begin[:3]] if begin else self._begins(swings))
        if one is not None and one.residual_counts < LOUD * floor:
            return one
        delay = self._scene.device.delay if one is None else one.delay.value
        hands = [begin] if begin[3:] else hands_on(delay, self._scene.rate)
        two = fit(swings=pieces_of(motions, math.ceil(_PIECE_S * self._scene.rate)), begins=hands)
        if two is None or two.hand is None or two.hand.mass.uncertainty > _UNSURE_HAND * two.hand.mass.value:
            return one
        return two if one is None or two.residual_counts < _HAND_LEAVES * one.residual_counts else one

    def _begins(self, swings: list[Swing]) -> list[Shape]:
        """Where a first fit may begin: what swings of these lengths could be of."""
        rows = float(np.median([swing.rows for swing in swings])) if swings else 1.0
        delays = np.arange(0.0, self._most_delay, _DELAY_STEP)
        every = product(delays, _FRICTIONS, _STIFFNESSES)
        return [(float(delay), friction / rows, stiffness / rows**2) for delay, friction, stiffness in every]

    def _seen(self, drive: Drive, trace: Trace, bounds: Bounds) -> Pushed:
        noise_m = self._noise_counts * self._count_m
        units = self._scene.units_of(self._channel)
        return Pushed(drive.force, self._peak(trace), bounds, noise_m, self._count_m, units)

    def _pushed(self, drive: Drive, duration: float, bounds: Bounds) -> Trace:
        """A run under this drive. GuardError where the device moved farther than it may."""
        trace = self._run(drive, bounds, duration)
        if trace.report.ending == travel.GUARD.words:
            error = why_too_far(self._fit([trace]), self._seen(drive, trace, bounds))
            error.trace = trace
            raise error
        return trace

    def _run(
        self, drive: Drive | None, bounds: Bounds, duration: float, push: PeriodicExcitation | None = None
    ) -> Trace:
        """A run, ended by the loop at the first sample that is too far away. `push`: in place of the drive's."""
        home = self._home_counts * self._count_m
        excitation = push if drive is None or push is not None else drive.excitation(self._channel)
        scene = scene_of(self._scene, bounds, self._channel, drive, home)
        try:
            trace = self._run_scene(scene, duration=duration, excitation=excitation)
        except GuardError as error:
            if error.trace is None or error.trace.report.ending != travel.GUARD.words:
                raise
            trace = error.trace
        self._stopped = trace.report.ending == IN_WORDS[STOPPED]
        return trace

    def _peak(self, trace: Trace) -> float:
        """m, how far from home, less what the noise alone may reach."""
        counts = trace.position_counts[:, self._channel] - self._home_counts
        far = float(np.max(np.abs(counts), initial=0.0)) - _NOISE_PEAK * self._noise_counts
        return max(far, 0.0) * self._count_m
