"""identify_device: pushes a device within bounds, and fits its mass, friction, stiffness and delay."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product
from typing import Any, NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray

from hapsim.device.known_motors import note_motors
from hapsim.errors import GuardError, UsageError
from hapsim.loop.endings import DONE, IN_WORDS, STOPPED
from hapsim.loop.guards import travel
from hapsim.measuring import measurement_options
from hapsim.measuring.converters import Converters
from hapsim.measuring.device_diagnosis import (
    LOUD,
    UNSURE,
    ForceResidual,
    PushedRun,
    fit_error,
    force_residual,
    misfit_of,
    polarity_error,
    travel_error,
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
from hapsim.measuring.device_sensor import AccelerationSensor, acceleration_sensor
from hapsim.measuring.trace_quality import ROUNDING, SeenRate, seen_rate, silence, silence_words
from hapsim.one_thread import one_thread
from hapsim.recording.trace import Trace
from hapsim.running.run import run_to_end
from hapsim.running.session_options import PeriodicExcitation
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene

SECONDS = 6.0
"""Default duration of the fitted record, s."""

_REST_S, _REST_TICKS = 0.1, 64
_GENTLE_HALVES, _GENTLE_TICKS = 12, 384
_LIGHTER = 10.0  # times lighter than declared: the mass that the gentlest push allows for
_COUNTS_OF_DAMPING = 1.5  # the gentlest push, in steps of the damper's force from one count of the position
_FIRST_MOVES, _FIRST_TRAVEL = 0.07, 0.2  # of the travel, at first: a device wired the wrong way runs away
_ENOUGH_TRAVEL = 0.35  # of the travel: enough for a fit
_TARGET_TRAVEL = 0.6  # of the travel
_UNSEEN, _UNSEEN_COUNTS = 0.07, 2.0
# Of the travel, and counts: the motion of a free mass as declared until its position changes. Even a mass ten times
# lighter then stays within the travel.
_STUCK_TRAVEL = 0.02  # of the travel
_SMALL_INCREASE, _LARGE_INCREASE = 1.25, 3.0
_MOST_ATTEMPTS = 36  # starting with the gentlest push
_MOST_RECORDINGS = 4  # after the first fit
_MOST_DECLARED, _LEAST_DELAY = 3.0, 8.0
_HEAVIEST_HAND = 1e3  # times the handle: a heavier one stands still
_HAND_RESIDUAL = 0.3  # of the residual with one mass: with less, two masses are accepted
_UNSURE_HAND = 0.3  # relative uncertainty of a hand's mass that is too large
_TURNING_ROWS, _EIGENS = 64, np.geomspace(0.02, 3.0, 60)  # of pieces of a swinging motion; rad per sample
_PIECE_S = 0.5  # length of the pieces for a fit of two masses
_NOISE_PEAK = 4.0  # times rms: the peak of a record's noise
_DELAY_STEP, _FRICTIONS, _STIFFNESSES = 2.0, (0.0, 1.0, 5.0, 20.0), (0.0, 3.0, 30.0)  # start values, by swings
_DRIVES = ((1.0, 0.5), (0.6, 1.0), (1.6, 0.7))  # pace and tightness: three simulated (K, B)


@dataclass(frozen=True, kw_only=True)
class DeviceIdentification(DeviceFit):
    """The identified device on one channel: the values of `DeviceFit`, and how they were measured. SI units."""

    noise_m: float
    """Noise of the positions at rest, m rms, with their rounding."""
    channel: int
    bounds: Bounds
    """Limits of the pushes."""
    drives: tuple[Drive, ...]
    """Simulated springs and dampers, and pushes, of the runs."""
    peak_m: float
    """Largest distance from the home position, m."""
    rate_hz: float
    count_m: float
    """Size of a position's count, m."""
    misfit: str
    """A sentence about the misfit of the model; "" if it fits."""
    stopped: bool
    """True if a signal ended the measurement early; the values are those of the record until then."""
    seen_rate: SeenRate | None
    """Rate at which the device sampled, from the arrival of its positions; None if they do not show it."""
    acceleration_sensor: AccelerationSensor | None
    """None if the device has none."""
    motions: tuple[Motion, ...] = field(repr=False, compare=False)
    force_residual: ForceResidual = field(repr=False, compare=False)
    traces: tuple[Trace, ...] = field(repr=False, compare=False)

    @property
    def residual_m(self) -> float:
        """Residual of the positions, m rms; ideally their rounding and noise alone."""
        return self.residual_counts * self.count_m


def bounds_of(scene: Scene, channel: int, force: float | None = None, travel: float | None = None) -> Bounds:
    """Returns the limits of the pushes [default: a quarter of the scene's force limit, 5 mm or 0.2 rad to either side].
    Raises UsageError for a force above the limit."""
    limit = measurement_options.force_limit(scene)
    measurement_options.require_device_point(scene, channel)
    units = scene.units_of(channel)
    if force is not None and not 0.0 < force <= limit:
        found, most = units(force, "N", "g"), units(limit, "N", "g")
        expected = f"expected above 0 {units.name('N')}, and at most the force_limit, {most}"
        raise UsageError(f"force: found {found}, {expected}")
    measurement_options.require_above_zero(units.name("metres"), travel=travel)
    travel = scene.device.scales(scene.channels)[channel].travel if travel is None else travel
    return Bounds(measurement_options.SHARE_OF_LIMIT * limit if force is None else force, travel)


def identify_device(scene: SceneSource, **options: Unpack[measurement_options.PushOptions]) -> DeviceIdentification:
    """Pushes the device of `scene` on a channel, without the scene's modules, and identifies it.

    A few seconds before the record, of 6 s by default, find the strength of the pushes. They begin with a fraction of
    the force that the declared mass needs, and grow. The declared mass, friction and delay may be wrong by a factor of
    three. Raises the errors of `run`, GuardError if the device moves beyond `travel`, and UsageError if nothing can be
    identified.
    """
    with pushing(scene, options) as (pusher, duration):
        rough = pusher.grow()
        pusher.record(rough, SECONDS if duration is None else duration)
        return pusher.identified(rough.shape)


class Asked(NamedTuple):
    """Request for an identification: the fields of `PushOptions`, with a `run` that has the others."""

    scene: Scene
    channel: int
    bounds: Bounds
    duration: float | None
    run: measurement_options.Run


def asked_of(source: SceneSource, options: measurement_options.PushOptions) -> Asked:
    """Returns the scene and the options of an identification. Raises UsageError for one that cannot be."""
    own: dict[str, Any] = {"channel": 0, "force": None, "travel": None, "duration": None, "run": run_to_end}
    given: dict[str, Any] = {**options}
    channel, force, travel, duration, run = (given.pop(name, otherwise) for name, otherwise in own.items())
    scene = as_scene(source)
    measurement_options.require_device_point(scene, channel)
    measurement_options.require_above_zero("seconds", duration=duration)
    # unstable: the force may fade within a narrow band, but the device does not stay there for long
    run = partial(run, **given | {"unstable": True})
    return Asked(scene, channel, bounds_of(scene, channel, force, travel), duration, run)


@contextmanager
def pushing(source: SceneSource, options: measurement_options.PushOptions) -> Iterator[tuple[Pusher, float | None]]:
    """Yields a pusher that has found the home position, and the given duration of the record, s. Afterwards the motor
    is known to be right, or, after a GuardError, not."""
    scene, channel, bounds, duration, run = asked_of(source, options)
    scene.require_impedance("pushes find no mass behind a servo, which `identify_servo` finds")
    pusher = Pusher(scene, channel, bounds, partial(run, also_sense=("acceleration",)))
    port = scene.device.port if options.get("transport", "auto") == "auto" else None
    try:
        with one_thread():
            pusher.find_home()
            yield pusher, duration
    except GuardError:
        note_motors(port, [channel], are_right=False)
        raise
    note_motors(port, [channel], are_right=True)


class Pusher:
    """Pushes a device within bounds, run after run, and keeps the records."""

    def __init__(self, scene: Scene, channel: int, bounds: Bounds, run: measurement_options.Run) -> None:
        self.scene, self.channel, self.bounds, self._run_scene = scene, channel, bounds, run
        self.converters = Converters(scene.device.hold, scene.device.sampling)
        self._most_delay = max(_LEAST_DELAY, _MOST_DECLARED * scene.device.delay + 1.0)
        self._home_counts = self.noise_counts = self._noise_m_s2 = 0.0
        self.count_m = 1.0
        self._records: list[tuple[Drive, Trace]] = []
        self.stopped = False
        """True if a signal ended the last run."""
        self.polarity_known = False
        """True once a motion has shown the polarity of the motor."""

    def find_home(self) -> None:
        """Finds the home position, at zero force, and the noise there. Raises GuardError if the device moves."""
        trace = self.run(None, self.bounds, max(_REST_S, _REST_TICKS / self.scene.rate))
        counts = trace.position_counts[:, self.channel].astype(float)
        self.count_m = float(trace.position_scale[self.channel])
        moved = float(np.ptp(counts)) * self.count_m if counts.size else 0.0
        if self.stopped or counts.size < _REST_TICKS // 2:
            raise UsageError("stopped before the device was pushed: nothing was identified")
        if moved > self.bounds.travel:
            units = self.scene.units_of(self.channel)
            cause = "The boards with a simulated mass give it a speed at each arming: they cannot be identified"
            if self.scene.device.port is None:
                cause = "A mock moves by itself if mock.hand or mock.initial moves it"
            raise GuardError(
                f"without any force the device moved by {units(moved, 'mm', '.3g')}, beyond the allowed "
                f"{units(self.bounds.travel, 'mm', 'g')}: it was not pushed. Let it rest, or hold it, and try again. "
                f"{cause}"
            )
        self._home_counts = float(np.median(counts))
        self.noise_counts = _noise(counts)
        if (sensed := trace.sensed.get("acceleration")) is not None:
            self._noise_m_s2 = _noise(sensed[:, self.channel])

    def grow(self) -> DeviceFit:
        """Pushes harder and harder until the device moves enough. Returns a first fit."""
        drive, trace = self.pushed_enough()
        return self._checked_fit(drive, trace, [trace])

    def pushed_enough(self) -> tuple[Drive, Trace]:
        """Pushes harder and harder until the device moves enough. Returns the last drive and its record."""
        scene, bounds = self.scene, self.bounds
        declared = Plant(scene.device.masses(scene.channels)[self.channel], 0.0, 0.0, scene.device.delay)
        full = drive_for(declared, bounds, scene.rate, pace=1.0, tightness=0.5)
        steepest = _LIGHTER * peak_per_newton(declared, full, scene.rate, self.converters)
        force = _FIRST_MOVES * bounds.travel / steepest
        if scene.device.port is not None:  # its guard ends a run in which rounding alone reaches the force limit
            clear = _COUNTS_OF_DAMPING * full.damping * scene.rate * self.count_m
            force = max(force, min(clear, 0.5 * _FIRST_TRAVEL * bounds.travel / (steepest / _LIGHTER)))
        force = min(full.force, force)
        gentle = replace(full, force=self._moving_force(full, force))
        first_travel = _FIRST_TRAVEL if gentle.force == force else 1.0  # it was stuck
        duration = max(_GENTLE_HALVES * full.half, _GENTLE_TICKS) / scene.rate
        drive, trace = self._run_until_enough(gentle, duration, steepest, first_travel * bounds.travel, _MOST_ATTEMPTS)
        if self.stopped:
            raise UsageError("stopped before enough was recorded: nothing was identified")
        return drive, trace

    def _moving_force(self, drive: Drive, force: float) -> float:
        """Returns the least force (N), at least `force`, that changes the position by a count. Raises UsageError if
        none does.

        Until then the sensor may be dead. So each push is +F, -F, -F, +F, each of them short: a free mass as declared
        moves by F t²/m at most, and returns to rest at its start."""
        device, travel, rate = self.scene.device, self.bounds.travel, self.scene.rate
        mass = device.masses(self.scene.channels)[self.channel]
        way = max(_UNSEEN * travel, min(_UNSEEN_COUNTS * self.count_m, _ENOUGH_TRAVEL * travel))
        acted, most = 0.0, min(self.bounds.push, way * mass * rate**2)  # no push is shorter than a sample
        force = min(force, most)
        while True:
            ticks = max(min(math.floor(math.sqrt(way * mass / force) * rate), drive.half), 1)
            signs = np.repeat([1.0, -1.0, -1.0, 1.0, 0.0], ticks)
            push = PeriodicExcitation(self.channel, force * signs)
            trace = self.run(replace(drive, force=force), self.bounds, (signs.size - 1) / rate, push)
            if self.stopped:
                raise UsageError("stopped before the device moved: nothing was identified")
            if np.ptp(trace.position_counts[:, self.channel]):
                return force
            acted += 4 * ticks / rate
            if force >= most:
                raise UsageError(silence_words(acted, force, self.scene.units_of(self.channel)))
            force = min(_SMALL_INCREASE * force, most)

    def record(self, rough: DeviceFit, duration: float) -> None:
        """Records the device at several simulated (K, B), with motions as large as the travel allows."""
        mass = rough.mass.value + (rough.hand.mass.value if rough.hand is not None else 0.0)
        plant = Plant(mass, *(max(one.value, 0.0) for one in (rough.friction, rough.stiffness, rough.delay)))
        piece = duration / len(_DRIVES)
        for pace, tightness in _DRIVES:
            drive = drive_for(plant, self.bounds, self.scene.rate, pace=pace, tightness=tightness)
            slope = peak_per_newton(plant, drive, self.scene.rate, self.converters)
            drive = replace(drive, force=min(drive.force, _TARGET_TRAVEL * self.bounds.travel / slope))
            self._records.append(self._run_until_enough(drive, piece, slope, self.bounds.travel, _MOST_RECORDINGS))
            if self.stopped:
                return

    def _run_until_enough(
        self, drive: Drive, duration: float, slope: float, travel: float, attempts: int
    ) -> tuple[Drive, Trace]:
        """Runs this drive, then stronger ones while the device moves too little, `attempts` runs at most. Returns the
        last drive and its trace. `slope`: largest motion per newton, m/N; `travel`: bound of the first run, m."""
        before: tuple[float, float] | None = None
        for _ in range(attempts):
            bounds, travel = replace(self.bounds, travel=travel), self.bounds.travel
            trace = self._pushed(drive, duration, bounds)
            if silence(trace, self.channel) and not self.stopped:
                force = self._moving_force(drive, min(_SMALL_INCREASE * drive.force, self.bounds.push))
                if drive.force < self.bounds.push:
                    drive = replace(drive, force=force)
                    continue
            peak = self.peak(trace)
            stuck = peak <= _STUCK_TRAVEL * travel
            if not (stuck or self.polarity_known):
                self.polarity_known = True
                if error := polarity_error(self.fit([trace]), self._pushed_run(drive, trace, self.bounds)):
                    raise error
            if self.stopped or peak > _ENOUGH_TRAVEL * travel or drive.force >= self.bounds.push:
                break
            slope = slope if before is None else (peak - before[1]) / (drive.force - before[0])
            before = None if stuck else (drive.force, peak)
            wanted = drive.force + max(_TARGET_TRAVEL * travel - peak, 0.0) / max(slope, 1e-300)
            # If it hardly moved, because of dry friction or a large mass, the force grows by a quarter at least.
            force = max(wanted, _SMALL_INCREASE * drive.force) if stuck else min(wanted, _LARGE_INCREASE * drive.force)
            drive = replace(drive, force=min(self.bounds.push, force))
        return drive, trace

    def identified(self, start: Shape) -> DeviceIdentification:
        """Returns the identification from all records. The fit starts from `start`."""
        rate, count_m, traces = self.scene.rate, self.count_m, [trace for _, trace in self._records]
        farthest = max(self._records, key=lambda record: self.peak(record[1]))
        fit = self._checked_fit(*farthest, traces, start)
        motions = self._motions(traces)
        lacking = force_residual(motions, fit, self.noise_counts, count_m, rate, self.converters)
        sensor = acceleration_sensor(motions, fit, self._noise_m_s2, count_m, rate, self.converters)
        return DeviceIdentification(
            **vars(fit),
            noise_m=self.noise_counts * count_m,
            channel=self.channel,
            bounds=self.bounds,
            drives=tuple(drive for drive, _ in self._records),
            peak_m=self.peak(farthest[1]),
            rate_hz=rate,
            count_m=count_m,
            misfit=misfit_of(fit, lacking, motions, self.noise_counts, self.scene.units_of(self.channel)),
            stopped=self.stopped,
            seen_rate=seen_rate(max(traces, key=lambda trace: trace.sample.size)),
            acceleration_sensor=sensor,
            motions=tuple(motions),
            force_residual=lacking,
            traces=tuple(traces),
        )

    def _motions(self, traces: list[Trace]) -> list[Motion]:
        return [motion_of(trace, self.channel, self._home_counts, self._most_delay) for trace in traces]

    def _checked_fit(self, drive: Drive, trace: Trace, traces: list[Trace], begin: Shape = ()) -> DeviceFit:
        """Returns the fit of `traces`. Raises the error that `trace`, of this drive, shows if the fit is unusable."""
        fit = self.fit(traces, begin)
        error = fit_error(fit, self._pushed_run(drive, trace, self.bounds))
        if error is not None:
            raise error
        assert fit is not None
        return fit

    def fit(self, traces: list[Trace], begin: Shape = ()) -> DeviceFit | None:
        """Returns a fit of one mass, or of two if their residual is much smaller. It starts from `begin` if given."""
        one = self.fit_one_mass(traces, begin[:3])
        if one is not None and one.residual_counts < LOUD * self._floor_counts:
            return one
        delay = self.scene.device.delay if one is None else one.delay.value
        hands = [begin] if begin[3:] else hands_on(delay, self.scene.rate)
        motions = self._motions(traces)
        two = self._fitted(motions, pieces_of(motions, math.ceil(_PIECE_S * self.scene.rate)), hands)
        if two is None or two.hand is None or two.hand.mass.uncertainty > _UNSURE_HAND * two.hand.mass.value:
            return one
        if two.hand.mass.value > _HEAVIEST_HAND * two.mass.value:  # so that its spring is one of the device's own
            return one
        return two if one is None or two.residual_counts < _HAND_RESIDUAL * one.residual_counts else one

    def fit_one_mass(self, traces: list[Trace], begin: Shape = ()) -> DeviceFit | None:
        """Returns a fit of one mass. A device that swings on a spring of its own turns too often for swings; its motion
        is fitted as a whole."""
        motions = self._motions(traces)
        swings = swings_of(motions, self.noise_counts)
        one = self._fitted(motions, swings, [begin] if begin else self._start_shapes(swings))
        if one is None or abs(one.mass.uncertainty) > UNSURE * abs(one.mass.value):
            turning = self._fitted(
                motions, pieces_of(motions, _TURNING_ROWS), [begin] if begin else self._eigen_shapes()
            )
            if turning is not None and turning.residual_counts < LOUD * self._floor_counts:
                return turning
        return one

    @property
    def _floor_counts(self) -> float:
        """Residual of a fit that leaves noise and rounding alone, counts rms."""
        return math.hypot(self.noise_counts, ROUNDING)

    def _fitted(self, motions: list[Motion], swings: list[Swing], begins: list[Shape]) -> DeviceFit | None:
        return fit_device(motions, swings, begins, self.count_m, self.scene.rate, self.converters, self._most_delay)

    def _start_shapes(self, swings: list[Swing]) -> list[Shape]:
        """Returns start values for a first fit, from the typical length of the swings."""
        rows = float(np.median([swing.rows for swing in swings])) if swings else 1.0
        delays = np.arange(0.0, self._most_delay, _DELAY_STEP)
        every = product(delays, _FRICTIONS, _STIFFNESSES)
        return [(float(delay), friction / rows, stiffness / rows**2) for delay, friction, stiffness in every]

    def _eigen_shapes(self) -> list[Shape]:
        """Returns start values for a device on a spring of its own, of any eigenfrequency up to half the rate."""
        delays = np.arange(0.0, self._most_delay, _DELAY_STEP)
        return [(float(delay), 0.0, float(eigen**2)) for delay, eigen in product(delays, _EIGENS)]

    def _pushed_run(self, drive: Drive, trace: Trace, bounds: Bounds) -> PushedRun:
        noise_m = self.noise_counts * self.count_m
        units = self.scene.units_of(self.channel)
        return PushedRun(drive.force, self.peak(trace), bounds, noise_m, self.count_m, units)

    def _pushed(self, drive: Drive, duration: float, bounds: Bounds) -> Trace:
        """Returns the trace of a run of this drive. Raises GuardError if the device moved farther than it may."""
        trace = self.run(drive, bounds, duration)
        if trace.report.ending == travel.GUARD.words:
            error = travel_error(self.fit([trace]), self._pushed_run(drive, trace, bounds))
            error.trace = trace
            raise error
        return trace

    def run(
        self, drive: Drive | None, bounds: Bounds, duration: float, push: PeriodicExcitation | None = None
    ) -> Trace:
        """Returns the trace of a run, which ends at the first sample out of bounds. `push`: in place of the drive's."""
        home = self._home_counts * self.count_m
        excitation = push if drive is None or push is not None else drive.excitation(self.channel)
        scene = scene_of(self.scene, bounds, self.channel, drive, home)
        try:
            trace = self._run_scene(scene, duration=duration, excitation=excitation)
        except GuardError as error:
            # where the force did not move the device, the next one is larger
            if error.trace is None or error.trace.report.ending not in (travel.GUARD.words, IN_WORDS[DONE]):
                raise
            trace = error.trace
        self.stopped = trace.report.ending == IN_WORDS[STOPPED]
        return trace

    def peak(self, trace: Trace) -> float:
        """Returns the largest distance from home, m, less the peak of the noise."""
        counts = trace.position_counts[:, self.channel] - self._home_counts
        far = float(np.max(np.abs(counts), initial=0.0)) - _NOISE_PEAK * self.noise_counts
        return max(far, 0.0) * self.count_m


def _noise(values: NDArray[np.float64]) -> float:
    """Returns the noise of values at rest, rms. A slow motion does not count."""
    return float(np.std(np.diff(values, 2))) / math.sqrt(6.0)
