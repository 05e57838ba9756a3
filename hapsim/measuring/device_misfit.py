"""Where the model of a device does not fit: with the position, with the velocity, or at the reversals."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import NDArray

from hapsim.holds import HOLDS
from hapsim.measuring.device_fit import DeviceFit
from hapsim.measuring.device_model import Converters
from hapsim.measuring.device_motion import ROUNDING, Motion, Swing

Vector = NDArray[np.float64]

_WINDOW = Polynomial([1.0, 0.0, -1.0]) ** 3  # (1 - s²)³ for s from -1 to 1
LEAST_WIDTH, _LEAST_WINDOWS = 8, 20


@dataclass(frozen=True)
class Balance:
    """Forces at the middle of R windows. Acceleration, velocity and position in m and sample periods, (R,)."""

    swing: NDArray[np.int64]
    """Index of the swing that each window lies in."""
    row: NDArray[np.int64]
    """Of its motion, at the middle of the window."""
    acceleration: Vector
    velocity: Vector
    position: Vector
    side: Vector
    force: Vector
    """N, at the delay that was asked for."""
    noise_gain: float
    """rms of an acceleration that white noise of 1 m rms makes."""

    @property
    def terms(self) -> NDArray[np.float64]:
        """(R, 5), what mass, friction, stiffness, dry friction and constant force are factors of."""
        columns = [self.acceleration, self.velocity, self.position, self.side, -np.ones_like(self.side)]
        return np.column_stack(columns)


def balance_of(
    motions: list[Motion], swings: list[Swing], count_m: float, converters: Converters, delay: float, width: int
) -> Balance:
    """Windows of `width` rows, half overlapping, inside of the swings. `count_m`: m per count."""
    half = 0.5 * width
    at = (np.arange(width) - 0.5 * (width - 1)) / half
    window, first, second = (p(at) for p in (_WINDOW, _WINDOW.deriv(), _WINDOW.deriv(2)))
    unit = float(np.sum(window))
    # The sums of the derivatives vanish exactly, so that a position may be counted from anywhere.
    first, second = first - np.mean(first), second - np.mean(second)
    second /= float(second @ (at * half) ** 2) / (2.0 * unit)
    first /= -float(first @ (at * half)) / unit
    late = delay + (0.5 if converters.sampling == "average" else 0.0)
    whole, weights = _force_weights(converters.hold, late, width)
    rows: list[tuple[float, ...]] = []
    for number, swing in enumerate(swings):
        motion = motions[swing.motion]
        for begin in range(swing.first, swing.last - width + 1, max(1, width // 2)):
            y = motion.position[begin : begin + width] * count_m
            push = _around(motion.force, begin - whole, weights.size) @ weights
            values = np.array([second @ y, -(first @ y), window @ y, push]) / unit
            rows.append((number, begin + width // 2, swing.side, *values))
    table = np.array(rows).reshape(-1, 7)
    number_of, row, side, acceleration, velocity, position, force = table.T
    return Balance(
        swing=number_of.astype(np.int64),
        row=row.astype(np.int64),
        acceleration=acceleration,
        velocity=velocity,
        position=position,
        side=side,
        force=force,
        noise_gain=float(np.linalg.norm(second)) / unit,
    )


def _force_weights(hold: str, delay: float, width: int) -> tuple[int, Vector]:
    """(w, weights of the forces from w rows before the window on): how much of each acts within it."""
    whole = math.ceil(delay) + 1
    half = 0.5 * width
    acts = np.arange(width + whole) - whole + delay - 0.5 * (width - 1)  # rows from the middle, when each begins to act
    weights, begin = np.zeros(acts.size), 0.0
    for duration, impulse, level, slope in HOLDS[hold].pieces(0.0):
        for age, (strikes, pushes, grows) in enumerate(itertools.zip_longest(impulse, level, slope, fillvalue=0.0)):
            since = (acts + begin + age) / half  # where this piece of each force begins
            window, edges = _WINDOW(since), np.clip([since, since + duration / half], -1.0, 1.0)
            weights += np.where(np.abs(since) < 1.0, strikes * window, 0.0)
            weights += half * (pushes - grows * half * since) * np.diff(_WINDOW.integ()(edges), axis=0)[0]
            weights += half**2 * grows * np.diff((_WINDOW * Polynomial([0.0, 1.0])).integ()(edges), axis=0)[0]
        begin += duration
    return whole, weights


def _around(force: Vector, begin: int, rows: int) -> Vector:
    """Forces from row `begin` on, which may lie before the record: then none acted."""
    if begin >= 0:
        return force[begin : begin + rows]
    return np.concatenate([np.zeros(-begin), force[: rows + begin]])


def width_for(swings: list[Swing]) -> int:
    """Rows of a window: a third of a swing, and less of a short record."""
    rows = [swing.rows for swing in swings]
    return max(LEAST_WIDTH, min(int(np.median(rows)) // 3, sum(rows) // _LEAST_WINDOWS))


BINS = 12
_LEAST_SHARE = 0.3  # of the variance of the force that is lacking: with less it goes with nothing in particular
_QUIET = 0.25  # of the force: noise that hides nothing
_LATER = 0.1  # sample periods: a difference of the delay
LOUD = 2.0  # times the noise at rest and the rounding


@dataclass(frozen=True)
class ForceResidual:
    """What force the model lacks, and where, in windows of a third of a swing. Arrays (R,), SI units."""

    motion: NDArray[np.int64]
    """Which run of the record."""
    row: NDArray[np.int64]
    """Of that run."""
    position: Vector
    """m from where the device was found."""
    velocity: Vector
    in_swing: Vector
    """Share of its swing that has passed, 0 at one reversal to 1 at the next."""
    force: Vector
    """N that acted beside the modelled ones, whatever the model's parameters."""
    modelled: NDArray[np.float64]
    """(R, 6) forces that the parameters are factors of, the last by the delay."""
    noise: float
    """N rms that noise and rounding of the positions make of it."""
    typical_force: float
    """N rms that was sent."""


def force_residual(
    motions: list[Motion], fit: DeviceFit, noise_counts: float, count_m: float, rate_hz: float, converters: Converters
) -> ForceResidual:
    """Of the swings of a fit, in windows as short as noise allows, a third of a swing at most. `noise_counts`: of a
    position of the device at rest, rms; `count_m`: m per count."""
    width = width_for(list(fit.swings))
    found = _in_windows(motions, fit, noise_counts, count_m, rate_hz, converters, width)
    while width >= 2 * LEAST_WIDTH:
        width //= 2
        finer = _in_windows(motions, fit, noise_counts, count_m, rate_hz, converters, width)
        if not finer.noise < _QUIET * _rms(finer.force):
            break
        found = finer
    return found


def _in_windows(
    motions: list[Motion],
    fit: DeviceFit,
    noise_counts: float,
    count_m: float,
    rate_hz: float,
    converters: Converters,
    width: int,
) -> ForceResidual:
    swings, delay = list(fit.swings), fit.delay.value
    balance = balance_of(motions, swings, count_m, converters, delay, width)
    # What is left moves like the device under the force that is lacking, and under no other.
    left = balance_of(_what_is_left(motions, fit), swings, count_m, converters, delay, width)
    inertia = fit.mass.value * rate_hz**2
    lacking = inertia * left.acceleration + fit.friction.value * rate_hz * left.velocity
    later = balance_of(motions, swings, count_m, converters, delay + _LATER, width)
    modelled = np.column_stack([balance.terms, later.force - balance.force])
    first = np.array([swings[i].first for i in balance.swing])
    rows = np.array([swings[i].rows for i in balance.swing])
    return ForceResidual(
        motion=np.array([swings[i].motion for i in balance.swing], dtype=np.int64),
        row=balance.row,
        position=balance.position,
        velocity=balance.velocity * rate_hz,
        in_swing=(balance.row - first) / rows,
        force=_beside(modelled, lacking + fit.stiffness.value * left.position),
        modelled=modelled,
        noise=balance.noise_gain * math.hypot(noise_counts, ROUNDING) * count_m * inertia,
        typical_force=_rms(balance.force),
    )


def _beside(explaining: NDArray[np.float64], force: Vector) -> Vector:
    """What no combination of the columns explains."""
    size = np.linalg.norm(explaining, axis=0)
    q, _ = np.linalg.qr(explaining[:, size > 0.0] / size[size > 0.0])
    return np.asarray(force - q @ (q.T @ force))


def _rms(values: Vector) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _what_is_left(motions: list[Motion], fit: DeviceFit) -> list[Motion]:
    """The motions less the modelled ones, in the swings; no force."""
    empty = [np.zeros_like(motion.position) for motion in motions]
    for swing, error in zip(fit.swings, fit.residuals, strict=True):
        empty[swing.motion][swing.first : swing.last] = error
    return [Motion(left, np.zeros_like(left), motion.known) for left, motion in zip(empty, motions, strict=True)]


def misfit_of(fit: DeviceFit, lacking: ForceResidual, noise_counts: float) -> str:
    """In a sentence, where the model does not fit; "" where what is left is noise and rounding. `noise_counts`: of a
    position of the device at rest, rms."""
    expected = math.hypot(noise_counts, ROUNDING)
    if fit.is_white and fit.residual_counts < LOUD * expected:
        return ""
    size = _rms(lacking.force)
    return (
        f"the model does not fit: it leaves {fit.residual_counts:.3g} counts rms of the positions, where rounding and "
        f"noise explain {expected:.2g}. The force that it lacks, {size:.2g} N rms beside pushes of "
        f"{lacking.typical_force:.2g} N rms, {_where(lacking)}."
    )


def _where(lacking: ForceResidual) -> str:
    at_position, position = _explained(lacking, lacking.position, 1.0)
    at_velocity, velocity = _explained(lacking, lacking.velocity, 1.0)
    # On either side of a reversal the same law lacks a force with the other sign.
    in_swing, moment = _explained(lacking, lacking.in_swing, np.sign(lacking.velocity))
    best = max(at_position, at_velocity, in_swing)
    if not best > _LEAST_SHARE:
        return "goes with neither position nor velocity nor reversals: a hand that moves by itself, or another force"
    if best == at_position:
        return f"goes with the position ({best:.0%} of it), and is largest at {1e3 * position:+.2g} mm"
    if best == at_velocity:
        return f"goes with the velocity ({best:.0%} of it), and is largest at {1e3 * velocity:+.2g} mm/s"
    where = "near the reversals" if abs(moment - 0.5) > 0.25 else "in the middle between two reversals"
    return f"is largest {where} ({best:.0%} of it)"


def binned(along: Vector, force: Vector) -> tuple[NDArray[np.int64], Vector, Vector]:
    """(the bin of each, the mean of `along` and of `force` in each): bins of as many values each."""
    edges = np.quantile(along, np.linspace(0.0, 1.0, BINS + 1))
    number = np.clip(np.searchsorted(edges, along, side="right") - 1, 0, BINS - 1)
    counts = np.maximum(np.bincount(number, minlength=BINS), 1)
    middles, means = (np.bincount(number, one, minlength=BINS) / counts for one in (along, force))
    return number, middles, means


def _explained(lacking: ForceResidual, along: Vector, sign: float | Vector) -> tuple[float, float]:
    """(share of the force's variance, beyond that of noise, that a force by bins of `along` explains, beyond chance and
    beyond what other parameters of the model would; where it is largest)."""
    force, rows = lacking.force, lacking.force.size
    if rows < 4 * BINS:
        return 0.0, 0.0
    number, middles, means = binned(along, force * sign)
    bins = np.eye(BINS)[number] * np.reshape(sign, (-1, 1))
    columns = np.column_stack([lacking.modelled, bins])
    left = float(np.sum(_beside(columns, force) ** 2)) / (rows - columns.shape[1])
    total = float(np.sum(force**2)) / (rows - lacking.modelled.shape[1])
    beyond = total - lacking.noise**2
    worst = int(np.argmax(np.abs(means)))
    return (min((total - left) / beyond, 1.0) if beyond > 0.0 else 0.0), float(middles[worst])
