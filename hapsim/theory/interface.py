"""Interface of motion and computer: samplings, holds and dampers by the names in a scene file, delays, and predictors.

A new sampling is an entry in `SAMPLINGS`, and a window in the mock. Holds are declared in `hapsim/holds.py`, dampers in
`hapsim/dampers.py`; this module derives the rest from their transfer functions. The loop uses a sampling's window
(``device_step.py``), an impedance its transfer function. A test compares the two.
"""

from __future__ import annotations

import itertools
import math
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np

from hapsim.dampers import DAMPERS, DamperModel
from hapsim.holds import HOLDS, Piece, Term
from hapsim.theory.arrays import Complexes, Floats


class Ahead(NamedTuple):
    """Sensed motion as the links see it: ahead of the reading by the mean lag of sampling, delay and hold, with the
    velocity and the acceleration that the device senses (Florens et al., §6.3).

    Attributes:
        delay: sample periods, which the loop assumes.
        age: forces by which the acceleration is older than the newest one that acts: 0 or 1.
        masses: (C,) kg, for which the change of the force since then is added to it; empty: it is not.
        period: the sample period that the loop assumes, over the true one.
    """

    delay: float
    age: int = 0
    masses: tuple[float, ...] = ()
    period: float = 1.0


class BoardLaw(NamedTuple):
    """Force law on the board (``board_lines.py``): ``steps`` local periods in a sample period; ``delay`` of the force
    behind its measurement, and ``window`` of the velocity, in local periods."""

    steps: int
    delay: int
    window: int

    @property
    def memories(self) -> int:
        """Numbers that the board remembers of a channel."""
        return self.window + self.delay


class PortInterface(NamedTuple):
    """Interface of motion and computer of one port of several; as of ``Network``."""

    delay: float
    hold: str
    sampling: str
    decimation: str = "last"


class Clocks(NamedTuple):
    """Clocks of several ports (``several_clocks.py``).

    Attributes:
        port: (C + M,) number of each channel's port, and of the port whose ticks move each mass.
        interfaces: (P,) of each port.
        phases: (P,) of each port's ticks in a sample period, from 0 to 1; empty: all ports have one clock.
    """

    port: tuple[int, ...]
    interfaces: tuple[PortInterface, ...]
    phases: tuple[float, ...] = ()


STATES = 3  # position, velocity, push


class StatePredictor(NamedTuple):
    """Observer of position (m), velocity (m/s) and push (N), with its predictions. The columns (3 + lags) of ``step``,
    ``reading`` and ``ahead`` are the state, and the forces that were computed before the next sample: f[n-1], f[n-2],
    ... for sample n."""

    step: Floats
    """Position and velocity at sample n before its reading, (2, 3 + lags), from the state at sample n - 1."""
    reading: Floats
    """Expected readings, (R, 3 + lags): a position and, where the device ``senses`` it, a velocity."""
    gains: Floats
    """Corrections of the state, (3, R), for each unit of difference between a reading and the expected one."""
    first: Floats
    """Corrections of position and velocity at the second sample, (2, R): no push is known yet."""
    ahead: Floats
    """Position and velocity at (n + delay) T, (2, 3 + lags), just before the force of sample n acts."""
    differences: bool = False
    """True if the damper uses the last two positions ahead instead of the velocity ahead."""
    mass: float = math.nan
    """Mass that it assumes, kg."""

    @property
    def lags(self) -> int:
        """Number of past forces that the predictor uses."""
        return int(self.ahead.shape[1]) - STATES

    @property
    def senses(self) -> bool:
        """True if the predictor reads velocities."""
        return len(self.reading) == 2

    def at_rest(self) -> Floats:
        """Position and velocity ahead, and push, (3, 2), at rest: for a constant reading of one metre, and the
        additions for each N of a constant force."""
        rows = np.vstack([self.step, self.reading[:1]])
        balance = np.vstack([np.eye(2, STATES), np.zeros(STATES)]) - rows[:, :STATES] * [[1.0], [1.0], [-1.0]]
        force = rows[:, STATES:].sum(axis=1) * [1.0, 1.0, -1.0]
        state = np.linalg.solve(balance, np.stack([[0.0, 0.0, 1.0], force], axis=-1))
        ahead = self.ahead[:, :STATES] @ state
        ahead[:, 1] += self.ahead[:, STATES:].sum(axis=1)
        return np.vstack([ahead, state[2]])

    def for_compliance(self, compliance: float) -> StatePredictor:
        """Returns this predictor with the position ahead moved by ``compliance`` metres per newton of push."""
        ahead = self.ahead.copy()
        ahead[0, 2] += compliance
        return self._replace(ahead=ahead)


def whole_and_fraction(delay: float) -> tuple[int, float]:
    """Whole samples and the fraction of one, 0 <= fraction < 1, of a delay in sample periods. A fraction below 1e-9 is
    none: what acts for so short a time has no digits."""
    whole = math.floor(delay + _LEAST_FRACTION)
    fraction = delay - whole
    return whole, fraction if fraction > _LEAST_FRACTION else 0.0


class Sampling(NamedTuple):
    """Sampling of a motion.

    Attributes:
        terms: of the transfer function from the position to the reading.
        window: the reading is the mean position over this part (0 to 1) of the sample period before the sample; 0: it
            is the position at the sample.
    """

    terms: tuple[Term, ...]
    window: float

    @property
    def lag(self) -> float:
        """Mean delay in sample periods."""
        return 0.5 * self.window


SAMPLINGS: dict[str, Sampling] = {
    # The computer reads the position at the instant of the sample.
    "ideal": Sampling(terms=(Term(1.0, 0.0, 0),), window=0.0),
    # It reads the mean position over the last sample period: "1 sample integrator at input" (Florens et al., §6.2).
    "average": Sampling(terms=(Term(1.0, 0.0, 1), Term(-1.0, 1.0, 1)), window=1.0),
}

ROUNDING, _LEAST_FRACTION = 1e-12, 1e-9  # sample periods


def hold_lag(hold: str) -> float:
    """Mean delay of a hold, in sample periods, for a slow motion."""
    return -math.fsum(
        weight * (-lag) ** (integrations + 1) / math.factorial(integrations + 1)
        for weight, lag, integrations in HOLDS[hold].terms
    )


def acting_at_sample(delay: float, hold: str, age: int) -> list[float]:
    """Weights of f[n-1], f[n-2], ... in the force that acts just after sample n, or just before it: ``age`` 1. A force
    that answers its own sample without a delay acts on nothing that is sensed there."""
    whole, fraction = whole_and_fraction(delay)
    segments = hold_segments(hold, fraction)
    if age == 0 and whole + fraction > 0.0:
        return [0.0] * (whole - 1) + list(segments[0].level)[0 if whole else 1 :]
    duration, _, level, slope = segments[-1]
    grown = itertools.zip_longest(level, slope, fillvalue=0.0)
    return [0.0] * whole + [at + duration * by for at, by in grown]


def hold_segments(hold: str, fraction: float) -> list[Piece]:
    """One sample period of a hold in time, computed from its transfer function. A new force acts from ``fraction`` of
    the period on, 0 <= fraction < 1. The durations add up to 1."""
    terms = HOLDS[hold].terms
    ends = [0.0, 1.0]
    for change in (fraction, *((fraction + term.lag) % 1.0 for term in terms)):
        if min(abs(change - end) for end in ends) > ROUNDING:
            ends.append(change)
    ends.sort()
    starts = [fraction - age for age in range(math.floor(fraction + max(term.lag for term in terms)) + 1)]
    found = []
    for begin, end in itertools.pairwise(ends):
        weights = [[_weight(terms, order, begin, start) for start in starts] for order in range(3)]
        for of_ages in weights:
            while of_ages and abs(of_ages[-1]) < ROUNDING:  # forces that have ended are omitted
                of_ages.pop()
        found.append(Piece(end - begin, *map(tuple, weights)))
    return found


def _weight(terms: tuple[Term, ...], order: int, time: float, start: float) -> float:
    """Contribution at ``time`` of a force from ``start`` on: an impulse, level or slope (``order`` 0, 1, 2)."""
    weight = 0.0
    for term in terms:
        since = time - (start + term.lag)
        if order == 0 and term.integrations == 0:
            weight += term.weight if abs(since) < ROUNDING else 0.0
        elif 0 < order <= term.integrations and since > -ROUNDING:
            power = term.integrations - order
            weight += term.weight * max(since, 0.0) ** power / math.factorial(power)
    return weight


class Lag(NamedTuple):
    """Force behind a hold and a delay, seen by a hand that may move at a motion and at all of its images at once.

    h(t) is the force with its images, for computed forces of size 1 at theta; w its mean times the constant velocity
    that the sampling reads: w = sum of weights exp(j lags theta), and the mean of |h|² is the sum of products cos(apart
    theta). Behind a zero-order hold it is 1.

    Attributes:
        lags: samples, (n,).
        weights: (n,), with the sum 1.
        apart: samples between two of the forces that act in one period, (n²,).
        products: means of the product of their weights, (n²,), with the sum 1.
    """

    lags: Floats
    weights: Floats
    apart: Floats
    products: Floats

    def read(self, later: Complexes) -> Complexes:
        """Returns w, conjugate, for later = exp(-j theta)."""
        return np.asarray(np.polyval(self.weights[::-1], later) * later ** int(self.lags[0]))

    def unread(self, theta: Floats) -> Floats:
        """Returns the part of the force that the reading does not show, (mean of |h|² - |w|²)/(4 sin²(theta/2))."""
        both = np.outer(self.weights, self.weights).ravel() - self.products
        half = 0.5 * theta[..., None]
        return np.asarray((np.sin(self.apart * half) / np.sin(half)) ** 2 @ both) / 2.0


@lru_cache(maxsize=64)
def lag_of(delay: float, hold: str) -> Lag:
    """Returns the lag of a hold without impulses."""
    whole, fraction = whole_and_fraction(delay)
    segments = hold_segments(hold, fraction)
    ages: Floats = np.arange(max(len(piece.level) for piece in segments), dtype=float)
    weights: Floats = np.zeros(ages.size)
    products: Floats = np.zeros((ages.size, ages.size))
    for duration, _, *acting in segments:
        level, slope = (np.pad(one, (0, ages.size - len(one))) for one in acting)
        middle = level + 0.5 * duration * slope
        weights += duration * middle
        products += duration * (np.outer(middle, middle) + duration**2 / 12.0 * np.outer(slope, slope))
    return Lag(1.0 + whole + ages, weights, np.subtract.outer(ages, ages).ravel(), products.ravel())


def damper_named(name: str, cutoff: float | None, rate: float, window: int = 1) -> DamperModel:
    """Returns the damper of this name. ``cutoff`` and ``rate``: Hz; only a filter has a cutoff, and needs it.
    ``window``: sample periods over which a backward damper takes its difference.

    Raises:
        ValueError: the name is unknown, or the cutoff or the window is missing, superfluous or not above zero.
    """
    if window != 1:
        if name != "backward" or window < 1:
            raise ValueError(f"window is {window!r}, but the {name} damper takes none: omit it.")
        return DamperModel((1.0 / window, *[0.0] * (window - 1), -1.0 / window))
    if name not in DAMPERS:
        raise ValueError(f"damper is {name!r}, but it has to be one of: {', '.join(DAMPERS)}.")
    if not DAMPERS[name].has_cutoff:
        if cutoff is not None:
            raise ValueError(f"cutoff is {cutoff!r}, but the {name} damper has none: omit it.")
        return DAMPERS[name].model(math.inf)
    if cutoff is None or not 0.0 < cutoff < math.inf:
        raise ValueError(f"cutoff is {cutoff!r}, but the {name} damper needs one, in Hz, greater than zero.")
    return DAMPERS[name].model(2.0 * math.pi * cutoff / rate)


def damper_transfer(damper: DamperModel, z: Complexes, w: Complexes) -> Complexes:
    """Transfer function v/y of a damper; its weights of positions add up to zero: a factor 1 - 1/z = w/z."""
    from_positions = np.polyval(np.cumsum(damper.of_positions)[-2::-1], 1.0 / z)
    return w / z * from_positions / (1.0 - np.polyval([*damper.of_velocities[::-1], 0.0], 1.0 / z))


def delay_and_hold(theta: Floats, delay: float, hold: str, sampling: str) -> Complexes:
    """Factor of delay, hold and sampling for a force that oscillates at theta radians per sample: its fundamental."""
    through = _through(HOLDS[hold].terms, theta) * _through(SAMPLINGS[sampling].terms, theta)
    return np.asarray(through * np.exp(-1j * delay * theta))


def damper_gain(damper: DamperModel, theta: Floats) -> Complexes:
    """Ratio of the damper's velocity to the true one at theta; 1: exact."""
    if damper.senses:
        return np.ones_like(theta, dtype=complex)
    return np.asarray(damper_velocity(damper, theta) / (1j * theta))


def damper_velocity(damper: DamperModel, theta: Floats) -> Complexes:
    """Transfer function of a damper from position to velocity, in metres per sample, at z = exp(j theta)."""
    w = 2j * np.sin(0.5 * theta) * np.exp(0.5j * theta)  # z - 1, without loss of digits
    return damper_transfer(damper, np.exp(1j * theta), w)


def _through(terms: tuple[Term, ...], theta: Floats) -> Complexes:
    """Transfer function at s = j theta, theta not 0. The powers 1/s, 1/s², … of the terms cancel in the sum, so each
    term is computed without them: exp(-lag s)/s^p without its first p powers is (-lag)^p times the remainder of the
    exponential series. This keeps all digits at small theta."""
    through = np.zeros(theta.shape, complex)
    for weight, lag, power in terms:
        through += weight * (-lag) ** power * _remainder(power, -1j * lag * theta)
    return through


def _remainder(power: int, z: Any) -> Complexes:
    """Sum of z^k / (k + power)!: the exponential series of z from z^power on, divided by z^power."""
    near, series = np.where(np.abs(z) < 1.0, z, 0.0), np.zeros_like(z)
    for k in reversed(range(20)):
        series = series * near + 1.0 / math.factorial(k + power)
    far, found = np.where(np.abs(z) < 1.0, 1.0, z), np.exp(z)
    for k in range(power):
        found = (found - 1.0 / math.factorial(k)) / far
    return np.where(np.abs(z) < 1.0, series, found)
