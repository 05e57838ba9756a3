"""Closed-loop poles from a record of positions and forces, by one linear regression.

Only force moves the hand's mass, so position y, force f and the rounding e of the position obey

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A is the closed loop's characteristic polynomial, whose roots are sought. d is the part of the recorded force that does
not obey the linear law of the scene: its rounding, clipping at the limit, an excitation. C is the open loop's
polynomial, because e passes the loop like the position of a mass that drifts (pole 1) and slows down (pole p). If the
scene's force remembers (a predictor, a filter, masses), C has the poles of this memory, D(q), too: position and force
are divided by D first. The law of the recorded forces has them (`scene_law.py`). After division by C, y is doubly
summed and the error e is white. Least squares is then the maximum-likelihood estimate, with the correct covariance.
Only p is searched for. The residuals choose order and p together: a wrong p makes the error
coloured, and further poles would be fitted to its colour. If a white force also shakes the mass, such as the rounding
of a sensed velocity, C has a conjugate pair of poles instead of 1 and p (`shaken`).

Between two turns of the hand, dry friction is a constant force. A segment from turn to turn has it as a regressor.

With C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y. Those of a lower
order are the first ones of a higher order, so one triangular factor for each p has the fits of all orders.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import entry
from hapsim.measuring.converters import Complexes, Floats

MOST_ORDER = 9
_DEPENDENT = 1e-14  # of a column: the largest remainder of one that depends on those before it
_KNOWN = 5.0  # uncertainties: the effect of a surplus is then certain enough to compare dry friction with it
_MARGIN = 2.0  # the least number of rows per unknown
_REACH = 4  # samples to either side over which a resting hand does not move
_STILL = 2.0  # counts, or standard deviations of the noise: the least motion
_FOURTH = 70.0  # the variance of white noise's fourth difference, over its own
_MEDIAN = 0.6745  # of a normal distribution's absolute value, in standard deviations


@dataclass(frozen=True)
class Segment:
    """Consecutive samples of one channel: position in counts from rest, and force beyond the scene's law."""

    position: Floats
    surplus: Floats
    slides: Floats
    """Mean direction of the motion until the next sample, -1 to 1; dry friction acts against it. A fit with friction
    needs segments of one direction: friction is then a constant force, beside another one that is the same in all
    segments, because the place of rest may be unknown."""
    rest_known: bool = True
    """False if the positions may not be relative to rest: a constant force then remains in the record."""
    stands: bool = False  # True if the scene has no spring, so that the hand stays where it stops
    own: Complexes = field(default_factory=lambda: np.zeros(0, complex))
    """Poles of the scene's force, if it depends on its own past: (n,), conjugate pairs in pairs, inside the circle."""

    @property
    def motions(self) -> int:
        """Number of motions that the segment has by itself: a drift, a slowing one, that of a constant force, and those
        of the force's own poles."""
        return (2 if self.rest_known else 3) + self.own.size


@dataclass(frozen=True)
class Fit:
    """A fitted A(q): coefficients g of G in the basis of `_factors`, their spread, and how well they fit."""

    order: int
    drift: complex  # p, the open loop's second pole; if complex, one of a conjugate pair that replaces both
    g: Floats  # the coefficients, shape (order,)
    spread: Floats
    """Square root of g's covariance, spread @ spread.T, so that no variance can become negative."""
    residual: float  # standard deviation of the equation's error, in counts
    rows: int
    dry: float = math.nan
    """Dry friction, N, from its effect and that of the surplus in the long run; NaN for a fit without both."""
    dry_clearly: float = 0.0  # the friction's coefficient over its uncertainty

    @property
    def polynomial(self) -> Floats:
        """A(z), highest power first, monic, shape (order + 1,)."""
        polynomial = np.zeros(self.order + 1)
        polynomial[:3] = _open_loop(self.drift)
        polynomial[1:] += self.g @ self.directions
        return polynomial

    @property
    def directions(self) -> Floats:
        """Contribution of a unit of g[i] to the polynomial below its leading term, row i of (order, order)."""
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
        """Prepares the fits. `floor`: the least error, from rounding, counts. `most_order`: a short record has less.
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
        """Schwarz's criterion, (drifts, orders from 0 on): the lower the better, infinite without a fit."""
        self.criterion += self._unknowns(np.arange(self.most_order + 1)) * math.log(self._rows)
        self.criterion[:, 1:][depends[:, self._columns(1) - 1 :: self._signals]] = np.inf
        self.criterion[:, :2] = np.inf

    def least_criterion(self, order: int) -> float:
        """Returns the criterion of an order with its best p."""
        return float(np.min(self.criterion[:, order])) if order <= self.most_order else math.inf

    def _use(self, segments: Sequence[Segment], most_order: int) -> bool:
        """Selects the segments that are long enough for this order. Returns True if they have enough rows."""
        self._segments = [one for one in segments if one.position.size > most_order + 1]
        self._rows = sum(one.position.size - most_order - 1 for one in self._segments)
        return self._rows >= _MARGIN * float(self._unknowns(most_order)) + 4

    def _columns(self, order: Any) -> Any:
        return self._slides + order * self._signals

    def _unknowns(self, order: Any) -> Any:
        return self._columns(order) + sum(one.motions for one in self._segments)

    def fit(self, order: int, at: int) -> Fit | None:
        """Returns the fit of an order and the p with index `at`; None if the record does not determine its unknowns."""
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
    """Returns the pole p of C (with its conjugate) if a white force also shakes the mass. `ratio`: its motion in a
    sample over the white error of the position. Factors their spectrum, |1 - 1/q|^4 + ratio^2 |(1 + 1/q) / 2|^2."""
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
    """Returns the triangular factors of one segment's equations for each p: (drifts, rows, columns).

    Columns: the regressors up to n - 1 of the position, and of the surplus if there is one: doubly summed, summed,
    unchanged, first difference, …; and y[n] as the last one. The segment's own motions are projected out: the drifting
    and slowing mass, alpha + beta p^n (alpha + beta n for p = 1), and if rest is unknown, that of a constant force.
    """
    signals = np.array([segment.position, segment.surplus] if with_surplus else [segment.position])
    motions, size = segment.motions, segment.position.size
    first = motions + 2 * with_slides
    tables = np.empty((len(drifts), first + len(signals) * order + 1, size - order - 1))
    _fill_motions(tables[:, : motions - segment.own.size], drifts)
    tables[:, motions - segment.own.size : motions] = _own_motions(segment.own, tables.shape[-1])
    signals = _divided(signals, segment.own)
    tables[:, -1] = signals[0, order + 1 :]
    if with_slides:
        constant = np.array([segment.slides, np.ones(size)])
        tables[:, motions:first] = _twice(constant, drifts)[1][..., order:-1]
    columns = tables[:, first:-1].reshape(len(drifts), order, len(signals), -1)
    slowed, twice = _twice(signals, drifts)
    columns[:, 0], columns[:, 1] = twice[..., order:-1], slowed[..., order:-1]
    for i in range(2, order):
        columns[:, i] = signals[:, order:-1]
        signals = np.diff(signals, axis=-1, prepend=0.0)
    return _triangular(tables.swapaxes(1, 2))[:, motions:, motions:]


def _triangular(tables: Floats) -> Floats:
    """Returns R of the QR decomposition of each table."""
    return np.asarray(np.linalg.qr(tables, mode="r"))


def _divided(signals: Floats, own: Complexes) -> Floats:
    """Returns each signal divided by D: (signals, samples)."""
    for root in own[own.imag >= 0.0]:
        slowed = np.empty((1, *signals.shape), complex)
        slow(signals, np.array([root]), slowed)
        signals = (root * slowed[0]).imag / root.imag if root.imag else slowed[0].real
    return signals


def _own_motions(own: Complexes, size: int) -> Floats:
    """Returns the motions of D's poles, (n, samples)."""
    modes = own[:, None] ** np.arange(size)
    return np.where(own.imag[:, None] < 0.0, modes.imag, modes.real)


def _twice(signals: Floats, drifts: Complexes) -> tuple[Floats, Floats]:
    """Returns each signal divided by C and before that its first difference, for each p: (drifts, signals, samples)."""
    slowed, pairs = np.empty((len(drifts), *signals.shape), complex), drifts.imag != 0.0
    slow(signals, drifts, slowed)
    once, twice, p = slowed.real.copy(), np.cumsum(slowed.real, axis=-1), drifts[pairs, None, None]
    twice[pairs] = (p * slowed[pairs]).imag / p.imag
    once[pairs] = np.diff(twice[pairs], axis=-1, prepend=0.0)
    return once, twice


@entry
def slow(signals: Floats, drifts: Complexes, slowed: Complexes) -> None:
    """Fills in y[n] = p y[n-1] + x[n] of each signal, for each p: (drifts, signals, samples)."""
    for d in range(drifts.size):
        for s in range(signals.shape[0]):
            y = 0j
            for n in range(signals.shape[1]):
                slowed[d, s, n] = y = drifts[d] * y + signals[s, n]


def _fill_motions(motions: Floats, drifts: Complexes) -> None:
    """Fills the rows (drifts, 2 or 3, samples) that are projected out. Their values are at most 1."""
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
    """Returns the mean direction of the motion from each sample to the next, -1 to 1. If the hand turns in between, the
    velocity is taken to change evenly."""
    velocity = np.gradient(position) if position.size > 1 else np.zeros_like(position)
    least = np.abs(velocity[:-1]) + np.abs(velocity[1:])
    return np.append((velocity[:-1] + velocity[1:]) / np.maximum(least, 1e-300), 0.0)


def noise_of(position: Floats) -> float:
    """Returns the standard deviation of the white noise of the positions, counts."""
    return float(np.median(np.abs(np.diff(position, 4))) / _MEDIAN / np.sqrt(_FOURTH)) if position.size > 4 else 0.0


def stands(position: Floats) -> NDArray[np.bool_]:
    """Returns the samples at which the hand rests within counts and noise, or has just stopped or started: dry friction
    then balances the acting force."""
    noise = noise_of(position)
    padded = np.pad(position, _REACH, mode="edge")
    still = np.abs(padded[2 * _REACH :] - padded[: -2 * _REACH]) <= _STILL * max(noise, 1.0)
    hardly = np.abs(np.diff(position, prepend=position[:1])) <= max(noise, 1.0)
    return _widened(still | (_widened(still, _REACH) & hardly), 1)


def _widened(chosen: NDArray[np.bool_], by: int) -> NDArray[np.bool_]:
    return np.convolve(chosen, np.ones(2 * by + 1), "same")[: chosen.size] > 0.5
