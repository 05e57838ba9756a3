"""identify_transmission: excites a free device, and finds motor, transmission and handle from its frequency response.

A multisine shakes the device while a slow ride carries it to and fro, so that dry friction keeps its sign for most of
the time and rounding is like noise. The ride has an odd number of periods in a period of the multisine, whose lines are
even and no multiples of it: dry friction and rounding of the ride do not reach them. A soft simulated spring holds the
home position. The force of the whole loop is recorded, so the spring is no part of the response. Each excitation has
other phases; the ride slides in phase from one to the next.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple, Unpack

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from hapsim.errors import GuardError, UsageError
from hapsim.loop.guards import travel as travel_guard
from hapsim.loop.ring import LATE_FORCE, OFF_GRID, UNSENT
from hapsim.measuring import measurement_options
from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.device_diagnosis import WRONG_SIGN
from hapsim.measuring.device_fit import Estimate
from hapsim.measuring.device_motion import Bounds
from hapsim.measuring.device_motion import Drive as Pushes
from hapsim.measuring.identify_device import Pusher, pushing
from hapsim.measuring.periodic_excitation import Lines, acting_force, multisine
from hapsim.measuring.trace_quality import ROUNDING, unbroken
from hapsim.measuring.transmission_fit import Plant, TransmissionFit, fit_transmission, response
from hapsim.measuring.transmission_play import MeasuredResponse, Spectra
from hapsim.recording.trace import Trace
from hapsim.running.session_options import PeriodicExcitation
from hapsim.scene.drive import Drive
from hapsim.scene.load import SceneSource

SECONDS = 25.0
"""Default duration of the shaking, s."""

_FEWEST = 4
_PERIOD_S, _KEPT, _WARM_UP = 1.0, 2, 1  # of the multisine; periods of each excitation after one that settles; at first
_HIGHEST, _STEP = 0.47, 0.008  # of the rate; relative distance of lines, where that is more than two periods
_RIDE_FORCE, _RIDE_TRAVEL, _FASTEST_RIDE = 0.4, 0.4, 0.015  # of the push, of the travel, of the rate
_SHAKE_TRAVEL = 0.1  # of the travel, by one line
_EVEN_BELOW_HZ = 20.0  # the force of a line grows with the root of its frequency, from here on
_HOLD_HZ, _HOLD_RATIO = 1.0, 0.5  # of the simulated spring; a firmer one would shake a soft belt
_RIDES = 12  # multiples of the ride, the odd ones of which dry friction excites
_TURN = 0.381966  # of a turn: the ride's phase from one excitation to the next
_SOFT, _STRONGER, _WEAKER = 0.3, 2.5, 0.6  # of the excitation: at first, and from trial to trial
_PEAK = 0.75  # of the travel
_WEIGHINGS = 3  # at one strength
_TRIALS, _ENOUGH, _AS_HEAVY = 12, 1.1, 1.3  # factors of the excitation, and of the mass, that are no reason for another
_UNSURE = 3.0  # uncertainties of a rough mass, at least
_STUCK, _FEW_COUNTS = 0.02, 20.0  # of the travel; counts of a motion that is too small
_WINDOWED = 1.5  # times the variance of noise without a window
_HIDDEN = 0.3  # relative standard deviation of the response: above it nothing is to be seen
_UNREST = 2.0  # times the noise at rest, in the median of the lines; a linear motion has 0.8 to 1.2
_LOST = 0.05  # of the positions of an excitation, at most
_SETTLED = 1e-5  # of the largest motion: what an excitation leaves to the next one


@dataclass(frozen=True, kw_only=True)
class TransmissionIdentification:
    """The identified motor, transmission and handle on one channel, and how they were measured. SI units."""

    channel: int
    bounds: Bounds
    rate_hz: float
    converters: Converters
    fit: TransmissionFit
    declared: Drive
    """The scene's motor and transmission."""
    measured: MeasuredResponse
    excitations: int
    push_n: float
    """Largest force."""
    peak_m: float
    """Largest distance from the home position, m."""
    noise_m: float
    """Noise of the positions at rest, m rms, without their rounding."""
    traces: tuple[Trace, ...] = field(repr=False, compare=False)

    @property
    def sees_motor(self) -> bool:
        """True if motor and stiffness are known apart: behind a sensor at the handle only by the declared motor
        mass."""
        return self.fit.best.sides.sensor == "motor" or self.declared.is_elastic

    @property
    def estimates(self) -> dict[str, Estimate]:
        """The values, by name: those of one mass, or of motor, transmission and handle; none if no model fits."""
        if not self.fit.fits:
            return {}
        best, plant, unsure = self.fit.best, self.fit.best.plant, self.fit.best.uncertainty
        names = {"friction": "friction", "own_stiffness": "stiffness", "motor_lag": "lag"}
        if self.fit.delay_found:
            names["delay"] = "delay"
        belt = {"stiffness": "belt", "damping": "damping"}
        if best.sides.sensor == "motor":
            belt = {"motor_mass": "motor", "handle_mass": "handle"} | belt
        names = belt | names if plant.motor and self.sees_motor else names
        found = {name: best.estimate(key) for name, key in names.items()}
        if "motor_mass" not in found:
            found = {"mass": Estimate(plant.mass, math.hypot(unsure.handle, unsure.motor))} | found
        if plant.motor:
            half = 0.5 * unsure.belt / plant.belt
            found["resonance_hz"] = Estimate(plant.resonance_hz, half * plant.resonance_hz)
            if best.sides.sensor == "motor":
                found["antiresonance_hz"] = Estimate(plant.antiresonance_hz, half * plant.antiresonance_hz)
        return found

    def fitted(self, frequency: Floats) -> dict[str, Complexes]:
        """Returns the fitted position over force, m/N, of one mass and of two at these frequencies, Hz."""
        fits = {"one_mass": self.fit.one, "two_masses": self.fit.two}
        return {
            name: response(fit.plant, fit.sides, frequency, self.rate_hz, self.converters) for name, fit in fits.items()
        }


def identify_transmission(
    scene: SceneSource, **options: Unpack[measurement_options.PushOptions]
) -> TransmissionIdentification:
    """Shakes the device of `scene` on a channel, which no hand holds, and identifies motor, transmission and handle.

    The pushes of `identify_device` find the mass first; the shaking takes 25 s by default. The delay is as the scene
    declares it, or a whole one near it, unless the response rules these out. Raises the errors of `identify_device`,
    and UsageError if the response is hidden or no linear one.
    """
    with pushing(scene, options) as (pusher, duration):
        mass = _rough_mass(pusher)
        plan, scale = _tried(pusher, mass)
        seconds = SECONDS if duration is None else duration
        needed = math.floor((seconds / plan.lines.period_s - _WARM_UP + 1e-6) / (_KEPT + 1))
        if needed < _FEWEST:
            raise UsageError(f"duration: found {seconds:g} s, expected at least {plan.seconds(_FEWEST):g} s")
        trace = _record(pusher, plan, needed, scale)
        begin, declared = _declared(pusher, mass)
        _require_motion(pusher, trace)
        measured, unrest = _measured(pusher, plan, trace, needed)
        _require_order(unrest)
        found = TransmissionIdentification(
            channel=pusher.channel,
            bounds=pusher.bounds,
            rate_hz=pusher.scene.rate,
            converters=pusher.converters,
            fit=fit_transmission(measured, pusher.scene.rate, pusher.converters, begin, declared),
            declared=declared,
            measured=measured,
            excitations=len(measured.each),
            push_n=float(np.max(np.abs(trace.force[:, pusher.channel]))),
            peak_m=pusher.peak(trace),
            noise_m=pusher.noise_counts * pusher.count_m,
            traces=(trace,),
        )
        _require_visible(found, pusher)
        return found


class _Plan(NamedTuple):
    """An excitation: the multisine's `lines` with their amplitudes (n,) in N, the ride in N with its number of periods,
    the largest force of the multisine in N, and the simulated spring that holds the device."""

    lines: Lines
    amplitude: Floats
    ride: float
    turns: int
    shake: float
    hold: Pushes

    def seconds(self, count: int) -> float:
        """Returns the duration of `count` excitations, s."""
        return (_WARM_UP + count * (_KEPT + 1)) * self.lines.period_s

    def ends(self, count: int) -> Iterator[int]:
        """Yields the sample after each excitation."""
        yield from (self.lines.samples * (_WARM_UP + (number + 1) * (_KEPT + 1)) for number in range(count))

    def forces(self, count: int, scale: float) -> Floats:
        """Returns the forces of `count` excitations, `scale` times as strong."""
        samples, waves, turned = self.lines.samples, [], []
        for number in range(count):
            settling, kept = samples * (1 if number else 1 + _WARM_UP), _KEPT * samples
            waves.append(np.resize(multisine(self.lines, self.amplitude, self.shake, number), settling + kept))
            # The ride slides to its next phase while the multisine settles.
            slid = np.append(np.linspace(-1.0 if number else 0.0, 0.0, settling, endpoint=False), np.zeros(kept))
            turned.append(_TURN * (number + slid) + self.turns * np.arange(slid.size) / samples)
        ride = self.ride * np.cos(2.0 * np.pi * np.concatenate(turned))
        return np.asarray(scale * (np.concatenate(waves) + ride))


def _rough_mass(pusher: Pusher) -> float:
    """Returns the mass that simple pushes find, or the declared one if they do not, kg."""
    pusher.polarity_known = True  # a soft belt may swing the other way; the ride shows the polarity
    _, trace = pusher.pushed_enough()
    rough = pusher.fit_one_mass([trace])
    declared = pusher.scene.device.masses(pusher.scene.channels)[pusher.channel]
    if rough is None or not rough.mass.value > _UNSURE * rough.mass.uncertainty:
        return declared
    return rough.mass.value


def _declared(pusher: Pusher, mass: float) -> tuple[Plant, Drive]:
    """Returns the declared device with this mass, kg, as one mass, and its motor and transmission."""
    device, channels, channel = pusher.scene.device, pusher.scene.channels, pusher.channel
    friction, stiffness = device.frictions(channels)[channel], device.stiffnesses(channels)[channel]
    return Plant(mass, friction, stiffness, 0.0, device.delay), device.drives(channels)[channel]


def _plan(pusher: Pusher, mass: float, stiffness: float) -> _Plan:
    """Returns the largest excitation within force and travel of this mass, kg, on a spring of its own, N/m."""
    rate, push, travel = pusher.scene.rate, pusher.bounds.push, pusher.bounds.travel
    samples = 2 * round(0.5 * _PERIOD_S * rate)
    period_s = samples / rate
    wide = _RIDE_TRAVEL * travel
    turning = math.sqrt(_RIDE_FORCE * push / (mass * wide))
    turns = 2 * max(math.floor(min(turning / (2.0 * math.pi), _FASTEST_RIDE * rate) * period_s / 2.0), 0) + 1
    turning = 2.0 * math.pi * turns / period_s
    ride = min(_RIDE_FORCE * push, wide * (mass * turning**2 + stiffness))
    bins = [turns + 1]
    while bins[-1] < _HIGHEST * samples:
        bins.append(2 * round(0.5 * max(bins[-1] + 2, bins[-1] * (1.0 + _STEP))))
    kept = [one for one in bins[:-1] if turns == 1 or one % turns]
    lines = Lines(np.array(kept, np.intp), samples, rate)
    shape = np.sqrt(np.maximum(lines.frequency, _EVEN_BELOW_HZ))
    shake = (1.0 - _RIDE_FORCE) * push
    shape *= lines.each(shake) / math.sqrt(float(np.mean(shape**2)))
    most = _SHAKE_TRAVEL * travel * (mass * (2.0 * np.pi * lines.frequency) ** 2 + stiffness)
    eigen = 2.0 * math.pi * _HOLD_HZ
    hold = Pushes(mass * eigen**2, 2.0 * _HOLD_RATIO * mass * eigen, push, samples)
    return _Plan(lines, np.minimum(shape, most), ride, turns, shake, hold)


def _tried(pusher: Pusher, mass: float) -> tuple[_Plan, float]:
    """Returns the excitation, and the share of it that stays within the travel, from short trials. They also show the
    whole mass, where a soft belt let the pushes find little more than the motor's."""
    stiffness, travel = _declared(pusher, mass)[0].stiffness, pusher.bounds.travel
    plan, scale, most, weighed = _plan(pusher, mass, stiffness), _SOFT, 1.0, 0
    for _ in range(_TRIALS):
        trace = _excited(pusher, plan, 1, scale)
        if trace is None:
            most = scale = _WEAKER * scale
            continue
        seen, is_braked = _ridden_mass(pusher, plan, trace, stiffness)
        if not (seen > 0.0 or is_braked):
            raise GuardError(WRONG_SIGN)
        # A weak ride weighs dry friction too, more at one speed than at another: a stronger one weighs better.
        if weighed < _WEIGHINGS and seen > 0.0 and not 1.0 / _AS_HEAVY < seen / mass < _AS_HEAVY:
            mass, weighed = seen, weighed + 1
            plan = _plan(pusher, mass, stiffness)
            continue
        stronger = min(most, scale * min(_PEAK * travel / max(pusher.peak(trace), 1e-12), _STRONGER))
        if stronger < _ENOUGH * scale:
            return plan, min(scale, stronger)
        scale, weighed = stronger, 0
    return plan, scale


def _ridden_mass(pusher: Pusher, plan: _Plan, trace: Trace, stiffness: float) -> tuple[float, bool]:
    """Returns the mass that the ride moves, kg, on a spring of the device's own, N/m, and whether friction brakes it;
    of a motor with the wrong sign both are negative. The mass is lost where dry friction takes most of the force."""
    last = slice(-_KEPT * plan.lines.samples, None)
    turned = np.exp(-2j * np.pi * plan.turns * np.arange(_KEPT * plan.lines.samples) / plan.lines.samples)
    moved, pushed = (one[last, pusher.channel] @ turned[-len(one) :] for one in (trace.position, trace.force))
    turning = 2.0 * math.pi * plan.turns / plan.lines.period_s
    met = complex(pushed / moved)
    return (stiffness - met.real) / turning**2, met.imag > 0.0


def _record(pusher: Pusher, plan: _Plan, count: int, scale: float) -> Trace:
    """Returns the record of `count` excitations. Raises GuardError if none stays within the travel."""
    for _ in range(_TRIALS):
        trace = _excited(pusher, plan, count, scale)
        if trace is not None:
            return trace
        scale *= _WEAKER
    units = pusher.scene.units_of(pusher.channel)
    raise GuardError(
        f"even a force of {units(scale * pusher.bounds.push, 'N', '.2g')} moved the device beyond the allowed "
        f"{units(pusher.bounds.travel, 'mm', 'g')}: it oscillates, or a hand moves it. Let go of it, or "
        "allow more with --travel"
    )


def _excited(pusher: Pusher, plan: _Plan, count: int, scale: float) -> Trace | None:
    """Returns the record of `count` excitations; None if the device moved farther than it may."""
    forces = plan.forces(count, scale)
    push = PeriodicExcitation(pusher.channel, forces)
    trace = pusher.run(plan.hold, pusher.bounds, (forces.size + 1) / pusher.scene.rate, push)
    if pusher.stopped:
        raise UsageError("stopped before enough was recorded: nothing was identified")
    return None if trace.report.ending == travel_guard.GUARD.words else trace


def _measured(pusher: Pusher, plan: _Plan, trace: Trace, count: int) -> tuple[MeasuredResponse, float]:
    """Returns the response by each excitation that lost few positions, and how much the periods of one differ,
    in noise at rest; 0 if none is in time. A window with soft ends keeps ride and decay from the lines."""
    samples, every = _KEPT * plan.lines.samples, np.arange(1, plan.lines.bins[-1] + 1)
    position, force, lost = _without_gaps(pusher, trace)
    calm = list(unbroken(trace, LATE_FORCE | OFF_GRID | UNSENT))
    window = (1.0 - np.cos(2.0 * np.pi * np.arange(samples) / samples)) * (2.0 / samples)
    at, excited = _KEPT * every, plan.lines.bins - 1
    moved, pushed, noise, is_calm = list[Complexes](), list[Complexes](), list[Floats](), list[bool]()
    for end in plan.ends(count):
        last = end - int(trace.sample[0])
        rows = slice(last - samples, last)
        if last > lost.size or np.mean(lost[rows]) > _LOST:
            continue
        for found, signal in ((moved, position), (pushed, force)):
            found.append(np.fft.rfft(signal[rows] * window)[at])
        # Between the lines there is nothing but noise, and a slow drift, which the second difference takes away.
        jerks = np.abs(np.fft.rfft(np.diff(position[last - samples - 2 : last], 2))) ** 2
        steep = 8.0 * samples**2 * np.sin(np.pi * at / samples) ** 4
        noise.append(_WINDOWED * (jerks[at - 1] + jerks[at + 1]) / steep)
        # A late force moves the device too, and what takes the place of a lost position is another.
        row = int(np.searchsorted(trace.sample, end))
        is_calm.append(any(begin <= row - samples and row <= stop for begin, stop in calm))
    if len(moved) < _FEWEST:
        raise UsageError(
            f"only {len(moved)} of {count} excitations were recorded with at least {1.0 - _LOST:.0%} of their "
            f"positions, expected {_FEWEST} or more: positions are lost. `hapsim doctor` shows which rates can be kept"
        )
    odd_rides = plan.turns * np.arange(1, _RIDES, 2)
    is_silent = (every % 2 == 1) & (every > odd_rides[0]) & ~np.isin(every, odd_rides)
    seen = np.array(moved), np.array(pushed), np.array(noise)
    spectra = Spectra(plan.lines.samples, every / plan.lines.period_s, *seen, is_silent)
    floor = max(math.hypot(pusher.noise_counts, ROUNDING) * pusher.count_m, _SETTLED * pusher.peak(trace))
    relative = spectra.noise[is_calm][:, excited] / np.abs(spectra.moved[is_calm][:, excited]) ** 2
    quiet = _WINDOWED * 4.0 / samples * floor**2 / np.abs(spectra.moved[is_calm][:, excited]) ** 2
    ratio = np.sqrt(np.mean(relative, axis=0) / np.mean(quiet, axis=0)) if any(is_calm) else np.zeros(1)
    return MeasuredResponse(spectra, excited), float(np.median(ratio))


def _without_gaps(pusher: Pusher, trace: Trace) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Returns the position and the acting force of each sample, and which positions are not known: a spline through the
    others, with the force before them."""
    sample, channel = trace.sample - trace.sample[0], pusher.channel
    known, every = trace.flags & OFF_GRID == 0, np.arange(int(sample[-1]) + 1)
    before = np.searchsorted(sample, every, side="right") - 1
    force = acting_force(trace, pusher.converters)[before, channel]
    if not pusher.converters.keeps_last_force:
        force = np.where(sample[before] == every, force, 0.0)
    lost = np.isin(every, sample[known], invert=True)
    return np.asarray(CubicSpline(sample[known], trace.position[known, channel])(every)), force, lost


def _require_motion(pusher: Pusher, trace: Trace) -> None:
    """Raises UsageError if the device hardly moved."""
    units, peak, travel = pusher.scene.units_of(pusher.channel), pusher.peak(trace), pusher.bounds.travel
    if peak > max(_STUCK * travel, _FEW_COUNTS * pusher.count_m):
        return
    push = float(np.max(np.abs(trace.force[:, pusher.channel]), initial=0.0))
    raise UsageError(
        f"forces of up to {units(push, 'N', '.3g')}, as many as the travel of {units(travel, 'mm', 'g')} allows, moved "
        f"the device by {units(peak, 'µm', '.3g')}: dry friction or a hand holds it, or that is too few counts of "
        f"{units(pusher.count_m, 'µm', '.3g')}. Let go of it, or allow more with --push and --travel"
    )


def _require_order(unrest: float) -> None:
    """Raises UsageError if the motion does not repeat. `unrest`: how much its periods differ, in noise at rest."""
    if unrest > _UNREST:
        raise UsageError(
            f"the motion does not repeat: under the same forces it differs by {unrest:.2g} times the noise at rest. "
            "Backlash between motor and handle makes it irregular and hides the transmission, or a hand moves the "
            "device. Take up the play, or release it, and try again"
        )


def _require_visible(found: TransmissionIdentification, pusher: Pusher) -> None:
    """Raises UsageError if the response is hidden."""
    units = pusher.scene.units_of(found.channel)
    push, moved = units(found.push_n, "N", ".3g"), units(found.peak_m, "µm", ".3g")
    hidden = float(np.median(found.measured.scatter)) / math.sqrt(found.excitations)
    if hidden > _HIDDEN and (found.fit.delay_found or not found.fit.masses):
        if (others := float(np.median(found.measured.scatter / found.measured.noise))) > _UNREST:
            raise UsageError(
                f"nothing was identified: the motion, {moved} at most under forces of up to {push}, is not in "
                f"proportion to them: it differs by {others:.2g} times the noise. Backlash between motor and handle or "
                "dry friction hides the response. Take up the play, or allow more with --push and --travel"
            )
        what, size = ("noise", found.noise_m) if found.noise_m > pusher.count_m else ("counts", pusher.count_m)
        raise UsageError(
            f"nothing was identified: the motion under forces of up to {push}, {moved} at most, is lost in the "
            f"position's {what} of {units(size, 'µm', '.3g')}. Allow more travel, force or time: --travel, --push, "
            "--duration"
        )
