"""Fits motor, transmission and handle of a device to its frequency response, position over force.

    m_m x_m'' = f - k (x_m - x_h) - c (x_m' - x_h') [- b0 x_m'],    tau f' + f = u
    m_h x_h'' =     k (x_m - x_h) + c (x_m' - x_h') [- b0 x_h'] - k0 x_h

u is the held force, some samples late; the friction b0 is that of one side. The response is that of the sampled motion,
so hold, delay and images beyond half the rate are exact. The same excitation with other phases is repeated several
times. What differs from one time to the next is noise, and what backlash and dry friction do; it weighs the fit
(Pintelon and Schoukens, *System Identification: A Frequency Domain Approach*, 2012, §4.3 and §13).

One mass is compared with two by the errors that they leave, in the noise of the fit. Dry friction and rounding alone
make errors of one mass of up to 1.3 times the noise. Where one mass is enough, the fit also says up to which resonance
two would have shown.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from hapsim.measuring.converters import Complexes, Converters, Floats
from hapsim.measuring.device_fit import Estimate
from hapsim.measuring.device_motion import sampled
from hapsim.measuring.transmission_play import MeasuredResponse, Play, Responses, play_in
from hapsim.scene.drive import SIDES, Drive, Side

CERTAIN = 4.0
"""Mean squared errors, relative to the better of two models: with more the other one is ruled out."""
POSSIBLE = 2.0
"""The same: with less the other model is as good. In between the record does not decide."""
_LEAST_LAG, _NO_LAG, _LONGEST_LAG = 1e-6, 2e-3, 30.0  # sample periods: of a fit; a shorter one is printed as none
_MOST, _GROWS, _INSIDE = 30.0, 0.1, 1e-9  # limits of the search: factors of the mass, growth in a sample, of the range
_OUTLIER = 20.0  # times the median of the squared errors
_UNSURE = 0.1  # relative uncertainty of a stiffness that was found
_ABOVE_LOWEST = 3.0  # times the lowest line: a resonance below it is none of a transmission
_RESONANCES, _SHARES = np.geomspace(0.008, 0.95, 64), (0.1, 0.3, 0.6)  # periods per sample; of the motor in the mass
_DAMPING_RATIO = 0.03  # of the pair's own motion, at first
_REFINED = 3  # resonances that are refined for each share of the motor
_TRIES, _ROUGH = 100, 12  # steps of a fit, and of one that others may surpass
_MISFIT = 2.0  # times the noise: a larger error gets a warning
_FIRST_LAG = 0.1  # sample periods
_SEEN = 0.4  # of the rate: a lower resonance would have to show, if one mass is to be enough
_DELAYS = 2  # whole samples to either side of a declared delay that does not fit
_IMAGE_RULED_OUT = 25.0  # of the squared errors, by the noise of the fit: five standard deviations
_HALF = 0.5  # sample: a whole delay that is more uncertain would be another one
_NEAR = 0.01  # of a resonance: a fit that ends so near is the same
_FAR = 1.0  # of a logarithm: a line that is farther off counts no more


class Plant(NamedTuple):
    """A device with one mass or two, SI units; the delay in sample periods."""

    handle: float  # kg; without a motor the whole mass
    friction: float
    stiffness: float  # of its own spring, at the handle
    lag: float
    delay: float
    motor: float = 0.0  # kg; 0: one mass
    belt: float = 0.0  # N/m
    damping: float = 0.0  # N·s/m, of the belt

    @property
    def mass(self) -> float:
        """Mass of motor and handle, kg."""
        return self.handle + self.motor

    @property
    def resonance_hz(self) -> float:
        """Frequency at which motor and handle swing against each other; NaN for one mass."""
        return math.sqrt(self.belt / self.pair) / (2.0 * math.pi) if self.motor else math.nan

    @property
    def antiresonance_hz(self) -> float:
        """Frequency at which the motor stands still beside a swinging handle; NaN for one mass."""
        return math.sqrt((self.belt + self.stiffness) / self.handle) / (2.0 * math.pi) if self.motor else math.nan

    @property
    def pair(self) -> float:
        """Mass with which motor and handle swing against each other, kg."""
        return self.handle * self.motor / self.mass

    def image(self, resonance_hz: float) -> Plant:
        """Returns the plant with another resonance, and the motor lighter or heavier so that it answers as much: if the
        two are mirrored at half the rate or at the rate, a loop distinguishes them by damping and lag alone."""
        motor = self.mass / (1.0 + self.handle / self.motor * (resonance_hz / self.resonance_hz) ** 2)
        other = self.with_belt(0.0, resonance_hz, motor)
        return other._replace(damping=self.damping * other.pair / self.pair)

    def with_belt(self, share: float, resonance_hz: float, motor: float = 0.0) -> Plant:
        """Returns the plant with a belt of this resonance. The motor has this `share` of the mass, or `motor` kg."""
        motor = min(motor or share * self.mass, 0.9 * self.mass)
        parted = self._replace(handle=self.mass - motor, motor=motor)
        turning = 2.0 * math.pi * resonance_hz
        return parted._replace(belt=parted.pair * turning**2, damping=2.0 * _DAMPING_RATIO * parted.pair * turning)


class Sides(NamedTuple):
    """Sides of a transmission: that whose position is read, and that with the viscous friction."""

    sensor: Side
    friction: Side


def response(
    plant: Plant, sides: Sides, frequency: Floats, rate: float, converters: Converters, by: str = "held"
) -> Complexes:
    """Returns the sampled position over the sent force (n,) at frequencies (n,) in Hz, m/N; or over another force that
    is held: on the "motor", or on the "handle"."""
    system, pushes = _equations(plant, sides, rate)
    motion = sampled(system, pushes[by], plant.delay, converters)
    return motion.response(np.exp(2j * np.pi * frequency / rate)) / (plant.mass * rate**2)


def _equations(plant: Plant, sides: Sides, rate: float) -> tuple[Floats, dict[str, Floats]]:
    """Returns matrix and inputs, as of `response`, of the state's change in a sample period: position and velocity of
    the sensed side, then of the other, and the lagging force per mass."""
    mass, share = plant.mass, plant.motor / plant.mass
    friction, stiffness = plant.friction / (mass * rate), plant.stiffness / (mass * rate**2)
    system = np.zeros((5, 5) if share else (3, 3))
    system[0, 1] = 1.0
    motor = handle = 1  # rows of their velocities
    inertia = {1: 1.0}
    if share:
        motor, handle = (1, 3) if sides.sensor == "motor" else (3, 1)
        inertia = {motor: share, handle: 1.0 - share}
        system[2, 3] = 1.0
        pull = np.array([plant.belt / rate, plant.damping]) / (mass * rate)
        system[1, :4] = np.array([*-pull, *pull]) / inertia[1]
        system[3, :4] = np.array([*pull, *-pull]) / inertia[3]
    rubbed = motor if sides.friction == "motor" else handle
    system[rubbed, rubbed] -= friction / inertia[rubbed]
    system[handle, handle - 1] -= stiffness / inertia[handle]
    one = np.eye(len(system))
    at_motor, at_handle = one[motor] / inertia[motor], one[handle] / inertia[handle]
    system[:, -1] += at_motor
    decay = 1.0 / max(plant.lag * rate, _LEAST_LAG)
    system[-1, -1] = -decay
    return system, {"held": decay * one[-1], "motor": at_motor, "handle": at_handle}


@dataclass(frozen=True)
class PlantFit:
    """A fitted plant, its standard uncertainties, and how well it fits."""

    plant: Plant
    uncertainty: Plant
    sides: Sides
    squares: float
    """Sum of squared errors in standard deviations."""
    freedom: int
    slopes: Floats = field(repr=False, compare=False)
    """(2 n, parameters) derivatives of the errors."""

    @property
    def misfit(self) -> float:
        """Mean of the squared errors: 1 for a model that leaves nothing but noise."""
        return self.squares / self.freedom

    def ratio_to(self, better: PlantFit) -> float:
        """Returns the ratio of the mean squared errors to those of a better fit, or to noise if that is more."""
        return self.misfit / max(better.misfit, 1.0)

    def widened(self, free: PlantFit) -> PlantFit:
        """Returns this fit of a known delay with the uncertainties that the delay of a free fit shows: by as many of
        its own as that is off, dry friction and rounding put off the others."""
        off, unsure = abs(free.plant.delay - self.plant.delay), free.uncertainty.delay
        wider = max(off / unsure, 1.0)
        values = Plant(*(wider * one for one in self.uncertainty))
        return replace(self, uncertainty=values._replace(delay=min(wider * unsure, _HALF)))

    def estimate(self, name: str) -> Estimate:
        """Returns a value of the plant with its uncertainty."""
        return Estimate(getattr(self.plant, name), getattr(self.uncertainty, name))


class Fitter:
    """Fits plants to one measured response."""

    def __init__(self, measured: MeasuredResponse, rate: float, converters: Converters) -> None:
        self.rate, self._measured, self._converters = rate, measured, converters
        self._mean, self._weight = measured.mean, math.sqrt(2.0) / measured.deviation

    def responses(self, fit: PlantFit) -> Responses:
        """Returns what play is seen by, at all lines."""
        given = self._measured.spectra.frequency, self.rate, self._converters
        at_once, here = fit.plant._replace(lag=0.0), fit.sides
        there = here._replace(sensor=SIDES[here.sensor == SIDES[0]])
        motor, handle = (response(at_once, here, *given, by=side) for side in SIDES)
        held, other = (response(fit.plant, sides, *given) for sides in (here, there))
        rubbed, rubbing = motor if here.friction == "motor" else handle, held if here.friction == here.sensor else other
        return Responses(held, rubbed, motor - handle, held - other, rubbing)

    def drop_outliers(self, fit: PlantFit) -> None:
        """Leaves out the lines that are far off this fit among all others: rounding of the ride reaches some."""
        squares = np.sum(self.errors(fit.plant, fit.sides).reshape(2, -1) ** 2, axis=0)
        self._weight = np.where(squares > _OUTLIER * max(float(np.median(squares)), 1.0), 0.0, self._weight)

    def errors(self, plant: Plant, sides: Sides) -> Floats:
        """Returns the errors (2 n,) of a plant, in standard deviations."""
        missing = self._weight * (
            response(plant, sides, self._measured.frequency, self.rate, self._converters) - self._mean
        )
        return np.concatenate([missing.real, missing.imag])

    def fit(self, begin: Plant, sides: Sides, fixed: Iterable[str] = ("delay",), tries: int = _TRIES) -> PlantFit:
        """Returns the fit that starts from `begin`, after `tries` steps at most. `fixed`: names of values that stay as
        they are there; without a motor there is one mass."""
        fixed = {*fixed, *(() if begin.motor else ("motor", "belt", "damping"))}
        names = [name for name in Plant._fields if name not in fixed]
        limits, rate = self._limits(begin), self.rate
        critical = 2.0 * math.sqrt(begin.belt * begin.pair)
        usual = {"friction": 1.0, "stiffness": 100.0 * begin.mass, "lag": 0.1 / rate, "damping": critical}
        scale = np.array([usual.get(name) or getattr(begin, name) or 1.0 for name in names])
        low, high = (np.array([limits[name][end] for name in names]) / scale for end in (0, 1))

        def of(scaled: Floats) -> Plant:
            return begin._replace(**dict(zip(names, (scaled * scale).tolist(), strict=True)))

        first = np.array([getattr(begin, name) for name in names]) / scale
        found = least_squares(
            lambda scaled: self.errors(of(scaled), sides),
            np.clip(first, low + _INSIDE * (high - low), high - _INSIDE * (high - low)),
            bounds=(low, high),
            x_scale="jac",
            max_nfev=tries,
        )
        slopes = np.asarray(found.jac)
        freedom = 2 * int(np.count_nonzero(self._weight)) - len(names)
        lengths = np.maximum(np.linalg.norm(slopes, axis=0), 1e-300)
        misfit = max(2.0 * found.cost / freedom, 1.0)
        sizes = np.linalg.norm(np.linalg.pinv(slopes / lengths), axis=1) * math.sqrt(misfit) / lengths
        unsure = dict.fromkeys(Plant._fields, 0.0) | dict(zip(names, (sizes * scale).tolist(), strict=True))
        plant = of(found.x)
        if plant.lag < _NO_LAG / rate:
            plant = plant._replace(lag=0.0)
        return PlantFit(plant, Plant(**unsure), sides, 2.0 * float(found.cost), freedom, slopes)

    def _limits(self, begin: Plant) -> dict[str, tuple[float, float]]:
        """Returns the least and most of each value that a fit tries: no motion grows much in a sample period, and no
        resonance is beyond the rate."""
        rate, mass = self.rate, begin.mass
        return {
            "handle": (mass / _MOST, mass * _MOST),
            "motor": (mass / _MOST**2, mass * _MOST),
            "friction": (-_GROWS * mass * rate, _MOST * mass * rate),
            "stiffness": (-_GROWS * mass * rate**2, mass * (math.pi * rate) ** 2),
            "lag": (_LEAST_LAG / rate, _LONGEST_LAG / rate),
            "delay": (0.0, begin.delay + _LONGEST_LAG),
            "belt": (0.0, mass * (2.0 * math.pi * rate) ** 2),
            "damping": (0.0, _MOST * mass * rate),
        }

    def one_mass(self, begin: Plant, sides: Sides) -> PlantFit:
        """Returns the best fit of one mass, from its mass, friction and spring as the response itself shows them."""
        turning = 2j * np.pi * self._measured.frequency
        late = self._converters.response(self._measured.frequency, self.rate, begin.delay)
        stiffness = late / self._mean  # -m w² + j w b + k
        weight = 1.0 / np.abs(stiffness)
        columns = np.stack([turning**2, turning, np.ones_like(turning)], axis=1) * weight[:, None]
        both = np.concatenate([columns.real, columns.imag])
        target = np.concatenate([(stiffness * weight).real, (stiffness * weight).imag])
        scale = np.linalg.norm(both, axis=0)
        mass, friction, own = (np.linalg.lstsq(both / scale, target, rcond=None)[0] / scale).tolist()
        shown = begin._replace(handle=abs(mass), friction=friction, stiffness=own)
        return min((self.fit(one, sides) for one in (shown, begin)), key=lambda fit: fit.squares)

    def two_masses(self, begin: Plant, sides: Sides, motor: float = 0.0) -> PlantFit:
        """Returns the best fit of two masses, of any resonance and motor. `motor`: kg, if it is known."""
        shares = (0.3,) if motor else _SHARES
        each = (sorted(self._distances(begin, sides, share, motor), key=lambda pair: pair[0]) for share in shares)
        rough = [self.fit(plant, sides, _fixed(sides), _ROUGH) for starts in each for _, plant in starts[:_REFINED]]
        best = sorted(rough, key=lambda fit: fit.squares)[:_REFINED]
        return _least(self.fit(one.plant, sides, _fixed(sides)) for one in best)

    def resolve_image(self, two: PlantFit) -> tuple[PlantFit, PlantFit | None]:
        """Returns the best of a fit of two masses and its images below the rate, and the other if it is not ruled out.
        Behind a sensor at the handle the mass alone says how much a resonance answers, so none has an image."""
        found, rate = two.plant.resonance_hz, self.rate
        if two.sides.sensor == "handle" or not found > 0.0:
            return two, None
        low = abs(found - round(found / rate) * rate)
        images = [one for one in (low, rate - low) if one > 0.0 and abs(one / found - 1.0) > _NEAR]
        fits = [self.fit(two.plant.image(one), two.sides) for one in images] + [two] * (found < rate)
        two, *others = sorted(fits, key=lambda fit: fit.squares)
        for image in others:
            apart = abs(image.plant.resonance_hz / two.plant.resonance_hz - 1.0)
            if apart > _NEAR and (image.squares - two.squares) / max(two.misfit, 1.0) < _IMAGE_RULED_OUT:
                return two, image
        return two, None

    def _distances(self, begin: Plant, sides: Sides, share: float, motor: float) -> Iterator[tuple[float, Plant]]:
        """Yields plants of every resonance with the mass that suits each best, and their mean distance from the
        response, of whose logarithms."""
        for resonance in (_RESONANCES * self.rate).tolist():
            plant = begin.with_belt(share, resonance, motor)
            ratio = self._mean / response(plant, sides, self._measured.frequency, self.rate, self._converters)
            gain = float(np.exp(np.median(np.log(np.abs(ratio)))))
            heavy = begin._replace(handle=begin.mass / gain).with_belt(share, resonance, motor)
            yield float(np.mean(np.minimum(np.abs(np.log(ratio / gain)), _FAR))), heavy

    def shows_up_to(self, one: PlantFit) -> float:
        """Returns the frequency in Hz below which any resonance of two masses would have shown beside this fit of one,
        wherever the sensor is; 0 for none."""
        basis, _ = np.linalg.qr(one.slopes)
        here, shown = self.errors(one.plant, one.sides), 0.0
        wanted = (CERTAIN - 1.0) * one.freedom * max(one.misfit, 1.0)
        for resonance in _RESONANCES[_RESONANCES * self.rate > _ABOVE_LOWEST * self._measured.frequency[0]]:
            for share, sensor in product(_SHARES, SIDES):
                plant = one.plant.with_belt(share, resonance * self.rate)
                lacking = self.errors(plant, one.sides._replace(sensor=sensor)) - here
                lacking -= basis @ (basis.T @ lacking)
                if float(lacking @ lacking) < wanted:
                    return shown
            shown = float(resonance * self.rate)
        return shown


def _fixed(sides: Sides) -> tuple[str, ...]:
    """Returns the names of the values that no response shows: at the handle, belt and motor's mass are one value."""
    return ("delay", "motor") if sides.sensor == "handle" else ("delay",)


@dataclass(frozen=True)
class TransmissionFit:
    """The fits of one mass and of two to a response, and the verdict."""

    rate_hz: float
    one: PlantFit
    two: PlantFit
    """The best fit of two masses; behind a sensor at the handle with the motor's mass as declared, or a tenth to six
    tenths of the whole."""
    sensor_certain: bool
    shows_up_to_hz: float
    """A lower resonance would have shown."""
    delay_found: bool
    """True if the response rules out the declared delay; the delay is then that of the fit."""
    declared_delay: float
    play: Play | None
    """Play between motor and handle, if the motion shows some."""
    image: PlantFit | None
    """Fit of two masses with the resonance mirrored at half the rate, if that is not ruled out."""

    @property
    def fits(self) -> bool:
        """True if a model leaves little more than noise."""
        return min(self.one.misfit, self.two.misfit) < _MISFIT**2

    @property
    def masses(self) -> int:
        """Number of masses that the response shows, 1 or 2; 0: it does not decide."""
        ratio = self.one.ratio_to(self.two)
        sure = self.two.uncertainty.belt < _UNSURE * self.two.plant.belt
        if not self.fits:
            return 0
        if ratio > CERTAIN and sure and self.sensor_certain and self.play is None and self.image is None:
            return 2
        return 1 if ratio < POSSIBLE and self.shows_up_to_hz > _SEEN * self.rate_hz else 0

    def verdict(self) -> list[str]:
        """Returns sentences: how many masses, and the evidence."""
        one, two = (math.sqrt(fit.misfit) for fit in (self.one, self.two))
        evidence = f"one mass leaves errors of {one:.3g} times the noise, two masses {two:.3g} times"
        shows = f"a resonance of motor and handle below {self.shows_up_to_hz:.3g} Hz would have shown"
        sentences = [f"Motor and handle are two masses: {evidence}."]
        if self.masses == 1:
            sentences = [f"One mass is enough: {evidence}; {shows}."]
        elif self.play is not None:
            sentences = [
                f"Cannot tell the transmission, because motor and handle have play between them: {evidence}, and they "
                "press on each other at frequencies at which nothing does."
            ]
        elif not self.fits:
            sentences = [
                f"Neither one mass nor two explain the motion, and no whole delay near {self.declared_delay:g} samples "
                f"does: {evidence}. Nothing was identified. The delay may be another, or backlash, dry friction or a "
                "hand may be the cause."
            ]
        elif self.image is not None and self.one.ratio_to(self.two) > CERTAIN:
            mirrored = self.image.plant.resonance_hz
            sentences = [
                f"Cannot tell the transmission: motor and handle are two masses ({evidence}), but a resonance at "
                f"{mirrored:.4g} Hz fits as well as one at {self.two.plant.resonance_hz:.4g} Hz. At this rate they are "
                "images of each other. Identify again at another rate, or for longer (--duration)."
            ]
        elif self.masses == 0:
            why = "and the stiffness is not known" if self.sensor_certain else "and either side may have the sensor"
            if self.one.ratio_to(self.two) < POSSIBLE:
                why = f"but only {shows}" if self.shows_up_to_hz else "but no resonance would have shown"
            sentences = [
                f"Whether motor and handle are two masses is unknown: {evidence}, {why}. Allow more force, travel or "
                "time (--push, --travel, --duration); a higher rate shows stiffer transmissions."
            ]
        return sentences

    @property
    def best(self) -> PlantFit:
        """The fit with this number of masses; if it is unknown, the simplest fit that is not ruled out."""
        return self.two if self.one.ratio_to(self.two) > CERTAIN else self.one


def fit_transmission(
    measured: MeasuredResponse, rate: float, converters: Converters, begin: Plant, declared: Drive
) -> TransmissionFit:
    """Returns the fits of one mass and of two. `begin`: a rough plant of one mass, with the declared delay. `declared`:
    the scene's transmission; where the record does not decide between the two sides, they are as it says."""
    fitter, here = Fitter(measured, rate, converters), Sides(declared.sensor, declared.friction_at)
    one, each = _at_delay(fitter, begin, here, declared)
    for delay in _whole_delays(begin.delay):
        if _least((one, *each)).misfit < CERTAIN:
            break
        other = _at_delay(fitter, begin._replace(delay=delay), here, declared)
        if _least((one, *each)).ratio_to(_least((other[0], *other[1]))) > CERTAIN:
            one, each = other
    two, other_side = sorted(each, key=lambda fit: fit.squares)
    certain = other_side.ratio_to(two) > POSSIBLE
    fitter.drop_outliers(two)
    one, *each = (fitter.fit(fit.plant, fit.sides, _fixed(fit.sides)) for fit in (one, *each))
    two, image = fitter.resolve_image(_least(each))
    if not certain and declared.is_elastic:
        two, certain = next(fit for fit in each if fit.sides.sensor == declared.sensor), True
    swapped = two.sides._replace(friction=SIDES[two.sides.friction == SIDES[0]])
    rubbed = fitter.fit(two.plant, swapped, _fixed(swapped))
    two = rubbed if two.ratio_to(rubbed) > POSSIBLE else two
    best = two if one.ratio_to(two) > CERTAIN else one
    free = fitter.fit(best.plant, best.sides, {*_fixed(best.sides)} - {"delay"})
    better = best.widened(free)
    if best.ratio_to(free) > POSSIBLE:
        whole = fitter.fit(free.plant._replace(delay=float(round(free.plant.delay))), free.sides, _fixed(free.sides))
        better = free if whole.ratio_to(free) > POSSIBLE else whole.widened(free)
    one, two = (one, better) if best is two else (better, two)
    play = play_in(measured.spectra, fitter.responses(two), two.plant.belt) if one.ratio_to(two) > POSSIBLE else None
    found = better.plant.delay != begin.delay
    return TransmissionFit(rate, one, two, certain, fitter.shows_up_to(one), found, begin.delay, play, image)


def _at_delay(fitter: Fitter, begin: Plant, here: Sides, declared: Drive) -> tuple[PlantFit, list[PlantFit]]:
    """Returns the best fit of one mass with the delay of `begin`, and those of two with the sensor at either side."""
    late = begin._replace(lag=_FIRST_LAG / fitter.rate)
    motors = {side: declared.motor_mass * (side == "handle") for side in SIDES}
    two = [fitter.two_masses(late, here._replace(sensor=side), motor) for side, motor in motors.items()]
    return fitter.one_mass(begin, here), two


def _whole_delays(declared: float) -> list[float]:
    """Returns the whole delays near the declared one, nearest first: a firmware is late by whole samples."""
    near = range(max(math.ceil(declared) - _DELAYS, 0), math.floor(declared) + _DELAYS + 1)
    return sorted((float(one) for one in near if one != declared), key=lambda one: abs(one - declared))


def _least(fits: Iterable[PlantFit]) -> PlantFit:
    return min(fits, key=lambda fit: fit.squares)
