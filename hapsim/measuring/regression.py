"""Closed-loop poles from a record of positions and forces, by one linear regression.

The hand's mass answers to force alone, so position y, force f and the rounding e of the position obey

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A is the closed loop's characteristic polynomial, whose roots are sought. d is what the recorded force has beyond the
linear law of the scene: its rounding, clipping at the limit, an excitation. C is the open loop's polynomial, for e goes
round the loop like the position itself, carried on by a mass that drifts (pole 1) and slows down (pole p). Divided by
C, the equation has y doubly summed and the white error e: least squares is then the maximum-likelihood estimate, with
an honest covariance. Only p is searched for; the residuals choose order and p.

With C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y. Of each table only
the triangular factor is worked out, which has all that least squares asks for.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np

from hapsim.measuring.converters import Floats

_MARGIN = 2.0  # rows per unknown below which a regression says nothing


@dataclass(frozen=True)
class Segment:
    """Consecutive samples of one channel: position in counts from rest, and force beyond the scene's law."""

    position: Floats
    surplus: Floats
    rest_known: bool = True
    """False where the position may not be counted from rest: a constant force then stays in the record."""


@dataclass(frozen=True)
class Fit:
    """A fitted A(q): coefficients g of G in the basis of `_Basis`, their spread, and how well they fit."""

    order: int
    drift: float
    """p, the open loop's second pole."""
    factor: Floats
    """The triangular factor of the equations, whose columns are scaled; (unknowns + 1, unknowns + 1), y[n] last."""
    scale: Floats
    """By which the columns of the unknowns were divided."""
    residual: float
    """Standard deviation of the equation's error, in counts."""
    least_error: float
    """That rounding leaves, in counts."""
    rows: int
    criterion: float
    """Schwarz's; the lower the better."""

    @cached_property
    def g(self) -> Floats:
        """The coefficients, shape (order,)."""
        solution = np.linalg.solve(self.factor[:-1, :-1], self.factor[:-1, -1]) / self.scale
        return np.asarray(-solution[: self.order])

    @cached_property
    def spread(self) -> Floats:
        """A square root of g's covariance, spread @ spread.T: no variance comes out negative."""
        inverse = np.linalg.inv(self.factor[:-1, :-1]) / self.scale[:, None]
        return np.asarray(inverse[: self.order] * max(self.residual, self.least_error))

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
    """The least-squares fits of some segments, each for one order and one p of `drifts`."""

    def __init__(self, segments: Sequence[Segment], drifts: Sequence[float], with_surplus: bool, floor: float) -> None:
        """`floor`: the least error that rounding leaves, in counts."""
        self._bases = [_Basis(segment, drifts, with_surplus) for segment in segments]
        self._drifts, self._signals, self._floor = list(drifts), 2 if with_surplus else 1, floor

    def fit(self, order: int, drift: float) -> Fit | None:
        """Returns the fit for one order and one p; None where the record is too short for these unknowns."""
        usable = [one for one in self._bases if one.size > order + 1]
        count = sum(one.size - order - 1 for one in usable)
        unknowns = order * self._signals + sum(2 if one.segment.rest_known else 3 for one in usable)
        if count < _MARGIN * unknowns + 4:
            return None
        at = self._drifts.index(drift)
        factors = [one.factor(order, at, drift) for one in usable]
        factor = factors[0] if len(factors) == 1 else _factor(np.vstack(factors))
        if len(factor) < factor.shape[1]:
            return None
        scale = np.sqrt(np.einsum("ij,ij->j", factor, factor)[:-1])
        scale[scale == 0.0] = 1.0
        factor[:, :-1] /= scale
        if np.abs(factor.diagonal()[:-1]).min() < 1e-14:
            return None
        left = float(factor[-1, -1]) ** 2
        variance, parameters = left / (count - unknowns), unknowns * math.log(count)
        criterion = count * math.log(max(variance, 1e-300) * (count - unknowns) / count) + parameters
        return Fit(order, drift, factor, scale, math.sqrt(variance), self._floor, count, criterion)


def _open_loop(drift: float) -> Floats:
    return np.array([1.0, -1.0 - drift, drift])


@cache
def _directions(order: int, drift: float) -> Floats:
    rows, polynomial = np.zeros((order, order)), np.array([1.0])
    for i in range(order):
        rows[i, : polynomial.size] = polynomial
        polynomial = _open_loop(drift) if i == 1 else np.convolve(polynomial, [1.0, -1.0])
    return rows


class _Basis:
    """The regressors of one segment: of its position, and of its surplus where that counts, doubly summed, summed, as
    it is, its first difference, …"""

    def __init__(self, segment: Segment, drifts: Sequence[float], with_surplus: bool) -> None:
        self.segment, self.size = segment, segment.position.size
        signals = np.array([segment.position, segment.surplus] if with_surplus else [segment.position])
        slowed, reach = np.repeat(signals[None], len(drifts), axis=0), 1
        ratio = np.array(drifts)[:, None, None]
        while reach < self.size:  # y[n] = p y[n-1] + x[n]: a running sum of 2, 4, 8, ... terms until it holds all
            slowed[..., reach:] += ratio**reach * slowed[..., :-reach]
            reach *= 2
        self._summed = np.stack([np.cumsum(slowed, axis=-1), slowed], axis=2)  # by p and signal
        self._differences = [signals]

    def factor(self, order: int, at: int, drift: float) -> Floats:
        """The triangular factor of the equations of an order with the p of number `at`: the regressors from everything
        up to n - 1, and y[n] as the last column.

        Projected out is what concerns this segment alone: its drifting and slowing mass, alpha + beta p^n
        (alpha + beta n where p = 1), and where rest is not known, what a constant force adds to that.
        """
        while len(self._differences) < order - 2:
            self._differences.append(np.diff(self._differences[-1], axis=-1, prepend=0.0))
        motions = 2 if self.segment.rest_known else 3
        signals = self._summed.shape[1]
        table = np.empty((self.size - order - 1, motions + signals * order + 1), order="F")
        self._project(table[:, :motions], drift)
        for number in range(signals):
            columns = table[:, motions + number * order : motions + (number + 1) * order].T
            columns[:2] = self._summed[at, number, :, order:-1]
            for i in range(2, order):
                columns[i] = self._differences[i - 2][number, order:-1]
        table[:, -1] = self.segment.position[order + 1 :]
        return _factor(table)[motions:, motions:]

    def _project(self, motions: Floats, drift: float) -> None:
        """Fills the columns of what is projected out; at most 1."""
        n, slowing = np.arange(len(motions), dtype=float), drift < 1.0 - 1e-12
        motions[:, 0] = 1.0
        motions[:, 1] = drift**n if slowing else n / max(n[-1], 1.0)
        if motions.shape[1] > 2:
            motions[:, 2] = (n if slowing else n**2) / max(n[-1] if slowing else n[-1] ** 2, 1.0)


def _factor(table: Floats) -> Floats:
    """R of a table's QR decomposition, by Householder's reflections."""
    reflections, _ = np.linalg.qr(table, mode="raw")
    factor = reflections.T[: table.shape[1]]
    return np.asarray(factor * _upper(*factor.shape))


@cache
def _upper(rows: int, columns: int) -> Floats:
    return np.triu(np.ones((rows, columns)))
