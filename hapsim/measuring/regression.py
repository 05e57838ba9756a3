"""Closed-loop poles from a record of positions and forces, by one linear regression.

The hand's mass answers to force alone, so position y, force f and the rounding e of the position obey

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A is the closed loop's characteristic polynomial, whose roots are sought. d is what the recorded force has beyond the
linear law of the scene: its rounding, clipping at the limit, an excitation. C is the open loop's polynomial, for e goes
round the loop like the position itself, carried on by a mass that drifts (pole 1) and slows down (pole p). Divided by
C, the equation has y doubly summed and the white error e: least squares is then the maximum-likelihood estimate, with
an honest covariance. Only p is searched for; the residuals choose order and p together, for a wrong p makes the error
coloured, and further poles are then fitted to its colour. Where a white force shakes the mass besides, as the rounding
of a velocity that the device senses does, C has a conjugate pair of poles in place of 1 and p (`shaken`).

Between two turns of the hand dry friction is a constant force of one sign or the other: a segment from turn to turn
has it as one more regressor.

With C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y. Those of a lower
order are the first ones of a higher order, so one triangular factor for each p has the fits of all orders.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.measuring.converters import Complexes, Floats

MOST_ORDER = 9
_DEPENDENT = 1e-14  # of a column: what the ones before it leave, if it depends on them
_FORGOTTEN = 1e-18  # of itself, beside a double's 1e-16
_KNOWN = 5.0  # uncertainties: what a surplus does is known well enough to compare dry friction with it
_MARGIN = 2.0  # rows per unknown below which a regression says nothing
_REACH = 4  # samples to either side, over which a hand that stands still does not move
_STILL = 2.0  # counts, or standard deviations of the noise: less than that is no motion
_FOURTH = 70.0  # the variance of white noise's fourth difference, over its own
_MEDIAN = 0.6745  # of a normal distribution's absolute value, in standard deviations


@dataclass(frozen=True)
class Segment:
    """Consecutive samples of one channel: position in counts from rest, and force beyond the scene's law."""

    position: Floats
    surplus: Floats
    slides: Floats
    """The mean direction, -1 to 1, in which the hand moves until the next sample: what dry friction acts against. With
    dry friction a segment has to be of one direction: it is then a force that stays the same, beside one that stays
    the same in all segments, as the place of rest may not be known."""
    rest_known: bool = True
    """False where the position may not be counted from rest: a constant force then stays in the record."""
    stands: bool = False  # whether the scene has no spring, so that the hand stays where it stops

    @property
    def motions(self) -> int:
        """How many motions of its own it has: a drift, a slowing one, and what a constant force adds."""
        return 2 if self.rest_known else 3


@dataclass(frozen=True)
class Fit:
    """A fitted A(q): coefficients g of G in the basis of `_factors`, their spread, and how well they fit."""

    order: int
    drift: complex  # p, the open loop's second pole; complex: of a conjugate pair, in place of both
    g: Floats  # the coefficients, shape (order,)
    spread: Floats
    """A square root of g's covariance, spread @ spread.T: no variance comes out negative."""
    residual: float  # standard deviation of the equation's error, in counts
    rows: int
    dry: float = math.nan
    """Dry friction, N, by what it and the surplus do to a hand in the long run; NaN of a fit without both."""
    dry_clearly: float = 0.0  # how many uncertainties the friction's part is above zero

    @property
    def polynomial(self) -> Floats:
        """A(z), highest power first, monic, shape (order + 1,)."""
        polynomial = np.zeros(self.order + 1)
        polynomial[:3] = _open_loop(self.drift)
        polynomial[1:] += self.g @ self.directions
        return polynomial

    @property
    def directions(self) -> Floats:
        """Row i: what a unit of g[i] adds to the polynomial below its leading term, shape (order, order)."""
        return _directions(self.order, self.drift)


class Regression:
    """The least-squares fits of some segments, for each order up to `most_order` and each p of `drifts`."""

    def __init__(
        self,
        segments: Sequence[Segment],
        drifts: Sequence[complex],
        floor: float,
        most_order: int = MOST_ORDER,
        with_slides: bool = False,
    ) -> None:
        """`floor`: the least error that rounding leaves, in counts. `most_order`: less where the record is short.
        `with_slides`: with dry friction."""
        self._drifts, self._floor = np.array(drifts, complex), floor
        with_surplus = any(np.any(segment.surplus) for segment in segments)
        self._signals, self._slides = 2 if with_surplus else 1, 2 * with_slides
        self.most_order = next((one for one in range(most_order, 1, -1) if self._use(segments, one)), 0)
        if self.most_order == 0:
            self.criterion = np.full((len(drifts), 1), np.inf)
            return
        columns = self._columns(self.most_order)
        factors = [_factors(one, self._drifts, with_surplus, self.most_order, with_slides) for one in self._segments]
        self._factors = factors[0] if len(factors) == 1 else _triangular(np.concatenate(factors, axis=1))
        self._scales = np.linalg.norm(self._factors[:, :, :columns], axis=1)
        self._scales[self._scales == 0.0] = 1.0
        left = np.cumsum(self._factors[:, ::-1, -1] ** 2, axis=1)[:, ::-1]  # what the first n columns leave, squared
        diagonal = np.abs(np.diagonal(self._factors, axis1=1, axis2=2)[:, :columns]) / self._scales
        depends = np.logical_or.accumulate(diagonal < _DEPENDENT, axis=1)
        self._left = left[:, self._slides :: self._signals]
        self.criterion = self._rows * np.log(np.maximum(self._left / self._rows, 1e-300))
        """Schwarz's, shape (drifts, orders from 0 on): the lower the better, infinite where there is no fit."""
        self.criterion += self._unknowns(np.arange(self.most_order + 1)) * math.log(self._rows)
        self.criterion[:, 1:][depends[:, self._columns(1) - 1 :: self._signals]] = np.inf
        self.criterion[:, :2] = np.inf

    def least_criterion(self, order: int) -> float:
        """Returns the criterion of an order with its best p."""
        return float(np.min(self.criterion[:, order])) if order <= self.most_order else math.inf

    def _use(self, segments: Sequence[Segment], most_order: int) -> bool:
        """Uses the segments that are long enough for this order. Returns whether these are enough."""
        self._segments = [one for one in segments if one.position.size > most_order + 1]
        self._rows = sum(one.position.size - most_order - 1 for one in self._segments)
        return self._rows >= _MARGIN * float(self._unknowns(most_order)) + 4

    def _columns(self, order: Any) -> Any:
        return self._slides + order * self._signals

    def _unknowns(self, order: Any) -> Any:
        return self._columns(order) + sum(one.motions for one in self._segments)

    def fit(self, order: int, at: int) -> Fit | None:
        """Returns the fit for one order and the p of this number; None where the record does not tell its unknowns."""
        if order > self.most_order or not np.isfinite(self.criterion[at, order]):
            return None
        columns = self._columns(order)
        scale = self._scales[at, :columns, None]
        inverse = np.linalg.inv(self._factors[at, :columns, :columns] / scale.T) / scale
        residual = math.sqrt(self._left[at, order] / (self._rows - self._unknowns(order)))
        g, spread = -inverse @ self._factors[at, :columns, -1], inverse * max(residual, self._floor)
        own = slice(self._slides, None, self._signals)
        dry, clearly = math.nan, 0.0
        if self._slides:
            is_pushed = self._signals > 1 and abs(g[3]) > _KNOWN * float(np.linalg.norm(spread[3]))
            dry = float(-g[0] / g[3]) if is_pushed else math.nan
            clearly = float(g[0] / np.linalg.norm(spread[0]))
        return Fit(order, complex(self._drifts[at]), g[own], spread[own], residual, self._rows, dry, clearly)


def shaken(ratio: float) -> complex:
    """Returns the pole p of C, with its conjugate, where a white force shakes the mass besides: by `ratio` of the white
    error of its position in a sample. It factors the spectrum of both, |1 - 1/q|^4 + ratio^2 |(1 + 1/q) / 2|^2."""
    u = ratio**2 / 8.0 + 1j * ratio * math.sqrt(1.0 - ratio**2 / 64.0)  # 2 - p - 1/p
    half = 1.0 - u / 2.0
    root = cmath.sqrt(half**2 - 1.0)
    return min(half + root, half - root, key=abs)


def _open_loop(drift: complex) -> Floats:
    other = drift.conjugate() if drift.imag else 1.0
    return np.array([1.0, -(other + drift).real, (other * drift).real])


@cache
def _directions(order: int, drift: complex) -> Floats:
    rows, polynomial = np.zeros((order, order)), np.array([1.0])
    for i in range(order):
        rows[i, : polynomial.size] = polynomial
        polynomial = _open_loop(drift) if i == 1 else np.convolve(polynomial, [1.0, -1.0])
    return rows


def _factors(segment: Segment, drifts: Complexes, with_surplus: bool, order: int, with_slides: bool) -> Floats:
    """The triangular factors of one segment's equations, for each p: (drifts, rows, columns).

    Columns: the regressors from everything up to n - 1, of its position, and of its surplus where that counts: doubly
    summed, summed, as it is, its first difference, …; and y[n] as the last one. Projected out is what concerns this
    segment alone: its drifting and slowing mass, alpha + beta p^n (alpha + beta n where p = 1), and where rest is not
    known, what a constant force adds to that.
    """
    signals = np.array([segment.position, segment.surplus] if with_surplus else [segment.position])
    motions, size = segment.motions, segment.position.size
    first = motions + 2 * with_slides
    tables = np.empty((len(drifts), first + len(signals) * order + 1, size - order - 1))
    _fill_motions(tables[:, :motions], drifts)
    if with_slides:
        constant = np.array([segment.slides, np.ones(size)])
        tables[:, motions:first] = _twice(constant, drifts)[1][..., order:-1]
    columns = tables[:, first:-1].reshape(len(drifts), order, len(signals), -1)
    slowed, twice = _twice(signals, drifts)
    columns[:, 0], columns[:, 1] = twice[..., order:-1], slowed[..., order:-1]
    for i in range(2, order):
        columns[:, i] = signals[:, order:-1]
        signals = np.diff(signals, axis=-1, prepend=0.0)
    tables[:, -1] = segment.position[order + 1 :]
    return _triangular(tables.swapaxes(1, 2))[:, motions:, motions:]


def _triangular(tables: Floats) -> Floats:
    """R of the QR decomposition of each."""
    return np.asarray(np.linalg.qr(tables, mode="r"))


def _twice(signals: Floats, drifts: Complexes) -> tuple[Floats, Floats]:
    """(The first difference of each signal divided by C, and that itself) for each p: (drifts, signals, samples)."""
    once, pairs = np.zeros((len(drifts), *signals.shape)), drifts.imag != 0.0
    once[~pairs] = _slowed(signals, drifts[~pairs].real)
    twice, p = np.cumsum(once, axis=-1), drifts[pairs, None, None]
    twice[pairs] = (p * _slowed(signals, drifts[pairs])).imag / p.imag
    once[pairs] = np.diff(twice[pairs], axis=-1, prepend=0.0)
    return once, twice


def _slowed(signals: Floats, drifts: Any) -> Any:
    """y[n] = p y[n-1] + x[n] of each signal, for each p: (drifts, signals, samples)."""
    slowed, ratio, reach = np.repeat(signals[None].astype(drifts.dtype), len(drifts), axis=0), drifts[:, None, None], 1
    # A running sum of 2, 4, 8, ... terms until it holds all that count.
    while reach < signals.shape[-1] and np.any(np.abs(ratio) ** reach > _FORGOTTEN):
        slowed[..., reach:] += ratio**reach * slowed[..., :-reach]
        reach *= 2
    return slowed


def _fill_motions(motions: Floats, drifts: Complexes) -> None:
    """Fills the rows that are projected out (drifts, 2 or 3, samples); at most 1."""
    n, slowing = np.arange(motions.shape[-1], dtype=float), np.abs(drifts) < 1.0 - 1e-12
    ramp, pairs = n / max(n[-1], 1.0), np.flatnonzero(drifts.imag)
    modes = drifts[:, None] ** n
    motions[:, 0] = 1.0
    motions[:, 1] = np.where(slowing[:, None], modes.real, ramp)
    motions[pairs, 0] = modes[pairs].imag
    if motions.shape[1] > 2:
        motions[:, 2] = np.where(slowing[:, None], ramp, ramp**2)
        motions[pairs, 2] = 1.0


def slides(position: Floats) -> Floats:
    """Returns the mean direction, -1 to 1, in which the hand moves from each sample to the next: where it turns round
    in between, by when a velocity that changes evenly is zero."""
    velocity = np.gradient(position) if position.size > 1 else np.zeros_like(position)
    least = np.abs(velocity[:-1]) + np.abs(velocity[1:])
    return np.append((velocity[:-1] + velocity[1:]) / np.maximum(least, 1e-300), 0.0)


def noise_of(position: Floats) -> float:
    """Returns the standard deviation of what is white in the positions, in counts."""
    return float(np.median(np.abs(np.diff(position, 4))) / _MEDIAN / np.sqrt(_FOURTH)) if position.size > 4 else 0.0


def stands(position: Floats) -> NDArray[np.bool_]:
    """Returns at which samples the hand stands still, as near as counts and noise tell, or has just begun or ceased to:
    dry friction then takes just the force that acts."""
    noise = noise_of(position)
    padded = np.pad(position, _REACH, mode="edge")
    still = np.abs(padded[2 * _REACH :] - padded[: -2 * _REACH]) <= _STILL * max(noise, 1.0)
    hardly = np.abs(np.diff(position, prepend=position[:1])) <= max(noise, 1.0)
    return _widened(still | (_widened(still, _REACH) & hardly), 1)


def _widened(chosen: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    return np.convolve(chosen, np.ones(2 * by + 1), "same")[: chosen.size] > 0.5
