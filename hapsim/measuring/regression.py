"""Closed-loop poles from a record of positions and forces, by one linear regression.

The hand's mass answers to force alone, so position y, force f and the rounding e of the position obey

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A is the closed loop's characteristic polynomial, whose roots are sought. d is what the recorded force has beyond the
linear law of the scene: its rounding, clipping at the limit, an excitation. C is the open loop's polynomial, for e goes
round the loop like the position itself, carried on by a mass that drifts (pole 1) and slows down (pole p). Divided by
C, the equation has y doubly summed and the white error e: least squares is then the maximum-likelihood estimate, with
an honest covariance. Only p is searched for; the residuals choose order and p.

With C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
    """A fitted A(q): coefficients g of G in the basis of `_basis`, their spread, and how well they fit."""

    order: int
    drift: float
    """p, the open loop's second pole."""
    g: Floats
    spread: Floats
    """A square root of g's covariance, spread @ spread.T: no variance comes out negative."""
    residual: float
    """Standard deviation of the equation's error, in counts."""
    rows: int
    criterion: float
    """Schwarz's; the lower the better."""

    @property
    def polynomial(self) -> Floats:
        """A(z), highest power first, monic, shape (order + 1,)."""
        return np.append(_open_loop(self.drift), np.zeros(self.order - 2)) + np.append(0.0, self.g @ self.directions)

    @property
    def directions(self) -> Floats:
        """Row i: what a unit of g[i] adds to the polynomial below its leading term, shape (order, order)."""
        rows, polynomial = np.zeros((self.order, self.order)), np.array([1.0])
        for i in range(self.order):
            rows[i, : polynomial.size] = polynomial
            polynomial = _open_loop(self.drift) if i == 1 else np.convolve(polynomial, [1.0, -1.0])
        return rows


def fit(segments: list[Segment], order: int, drift: float, with_surplus: bool, floor: float) -> Fit | None:
    """The least-squares fit for one order and one p; None where the record is too short for these unknowns.

    `floor`: the least error that rounding leaves, in counts.
    """
    usable = [segment for segment in segments if segment.position.size > order + 1]
    count = sum(segment.position.size - order - 1 for segment in usable)
    unknowns = order * (2 if with_surplus else 1) + sum(2 if segment.rest_known else 3 for segment in usable)
    if count < _MARGIN * unknowns + 4:
        return None
    table = np.vstack([_equations(segment, order, drift, with_surplus) for segment in usable])
    matrix, target = table[:, :-1], table[:, -1]
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(matrix / scale)
    if np.min(np.abs(np.diag(r))) < 1e-14:
        return None
    solution = np.linalg.solve(r, q.T @ target) / scale
    error = target - matrix @ solution
    variance = float(error @ error) / (count - unknowns)
    return Fit(
        order,
        drift,
        -solution[:order],
        (np.linalg.inv(r) / scale[:, None])[:order] * max(math.sqrt(variance), floor),
        math.sqrt(variance),
        count,
        count * math.log(max(variance, 1e-300) * (count - unknowns) / count) + unknowns * math.log(count),
    )


def _open_loop(drift: float) -> Floats:
    return np.array([1.0, -1.0 - drift, drift])


def _basis(x: Floats, order: int, drift: float) -> Floats:
    """x doubly summed, summed, x, its first difference, …: shape (samples, order)."""
    slowed, reach = x.copy(), 1
    while reach < x.size:  # y[n] = p y[n-1] + x[n]: a running sum of 2, 4, 8, ... terms until it holds all
        slowed[reach:] += drift**reach * slowed[:-reach].copy()
        reach *= 2
    columns = [np.cumsum(slowed), slowed, x]
    while len(columns) < order:
        columns.append(np.diff(columns[-1], prepend=0.0))
    return np.column_stack(columns[:order])


def _equations(segment: Segment, order: int, drift: float, with_surplus: bool) -> Floats:
    """(rows, unknowns + 1): the regressors of one segment, from everything up to n - 1, and y[n] as the last column.

    Projected out is what concerns this segment alone: its drifting and slowing mass, alpha + beta p^n (alpha + beta n
    where p = 1), and where rest is not known, what a constant force adds to that.
    """
    signals = (segment.position, segment.surplus) if with_surplus else (segment.position,)
    regressors = np.hstack([_basis(signal, order, drift)[order:-1] for signal in signals])
    table = np.column_stack([regressors, segment.position[order + 1 :]])
    n = np.arange(len(table), dtype=float)
    slowing = drift < 1.0 - 1e-12
    motions = [np.ones_like(n), drift**n if slowing else n]
    if not segment.rest_known:
        motions.append(n if slowing else n**2)
    q, r = np.linalg.qr(np.column_stack([motion / np.max(motion, initial=1e-300) for motion in motions]))
    q = q[:, np.abs(np.diag(r)) > 1e-12]
    return np.asarray(table - q @ (q.T @ table))
