"""Closed-loop poles from a record of positions and forces, by one linear regression.

The hand's mass answers to force alone, so position y, force f and the rounding e of the position obey

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A is the closed loop's characteristic polynomial, whose roots are sought. d is what the recorded force has beyond the
linear law of the scene: its rounding, cuts at the limit, an excitation. C is the open loop's polynomial, for e goes
round the loop like the position itself, carried on by a mass that drifts (pole 1) and slows down (pole p). Divided by
C, the equation has y doubly summed and the white error e: least squares is then the maximum-likelihood estimate, with
an honest covariance. Only p is searched for; the residuals choose order and p.

With C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_MARGIN = 2.0  # rows per unknown below which a regression says nothing


@dataclass(frozen=True)
class Segment:
    """Consecutive samples of one channel: position in counts from rest, and force beyond the scene's law."""

    position: Vector
    surplus: Vector
    rest_known: bool = True
    """False where the position may not be counted from rest: a constant force then stays in the record."""


@dataclass(frozen=True)
class Fit:
    """A fitted A(q): coefficients g of G in the basis of `_basis`, their spread, and how well they fit."""

    order: int
    drift: float
    """p, the open loop's second pole."""
    g: Vector
    spread: Matrix
    """A square root of g's covariance, spread @ spread.T: no variance comes out negative."""
    residual: float
    """Standard deviation of the equation's error, in counts."""
    rows: int
    criterion: float
    """Schwarz's; the lower the better."""

    @property
    def polynomial(self) -> Vector:
        """A(z), highest power first, monic, shape (order + 1,)."""
        return np.append(_open_loop(self.drift), np.zeros(self.order - 2)) + np.append(0.0, self.g @ self.directions)

    @property
    def directions(self) -> Matrix:
        """Row i: what a unit of g[i] adds to the polynomial below its leading term, shape (order, order)."""
        rows, polynomial = np.zeros((self.order, self.order)), np.array([1.0])
        for i in range(self.order):
            rows[i, : polynomial.size] = polynomial
            polynomial = _open_loop(self.drift) if i == 1 else np.convolve(polynomial, [1.0, -1.0])
        return rows


def fit(segments: list[Segment], order: int, drift: float, with_surplus: bool, floor: float) -> Fit | None:
    """The least-squares fit for one order and one p; None where the record is too short for so many unknowns.

    `floor`: the least error that rounding leaves, in counts.
    """
    blocks = [(*_rows(segment, order, drift, with_surplus), segment.rest_known) for segment in segments]
    blocks = [block for block in blocks if block[1].size > 0]
    unknowns = order * (2 if with_surplus else 1)
    count = sum(target.size for _, target, _ in blocks)
    total = unknowns + sum(2 if rest_known else 3 for _, _, rest_known in blocks)
    if count < _MARGIN * total + 4:
        return None
    # The free motion at the start of each segment concerns that segment alone: projected out before stacking.
    reduced = [_without_free_motion(rows, target, drift, rest_known) for rows, target, rest_known in blocks]
    matrix = np.vstack([rows for rows, _ in reduced])
    target = np.concatenate([target for _, target in reduced])
    scale = np.linalg.norm(matrix, axis=0)
    scale[scale == 0.0] = 1.0
    q, r = np.linalg.qr(matrix / scale)
    if np.min(np.abs(np.diag(r))) < 1e-14:
        return None
    solution = np.linalg.solve(r, q.T @ target) / scale
    error = target - matrix @ solution
    variance = float(error @ error) / (count - total)
    half = np.linalg.inv(r) / scale[:, None]
    return Fit(
        order,
        drift,
        -solution[:order],
        half[:order] * max(math.sqrt(variance), floor),
        math.sqrt(variance),
        count,
        count * math.log(max(variance, 1e-300) * (count - total) / count) + total * math.log(count),
    )


def _open_loop(drift: float) -> Vector:
    return np.array([1.0, -1.0 - drift, drift])


def _slowed(x: Vector, drift: float) -> Vector:
    """y[n] = p y[n-1] + x[n]: a running sum of 2, 4, 8, ... terms until it holds all."""
    y, reach = x.copy(), 1
    while reach < y.size:
        y[reach:] += drift**reach * y[:-reach].copy()
        reach *= 2
    return y


def _basis(x: Vector, order: int, drift: float) -> Matrix:
    """x doubly summed, summed, x, its first difference, …: shape (samples, order)."""
    slowed = _slowed(x, drift)
    columns = [np.cumsum(slowed), slowed, x]
    while len(columns) < order:
        columns.append(np.diff(columns[-1], prepend=0.0))
    return np.column_stack(columns[:order])


def _rows(segment: Segment, order: int, drift: float, with_surplus: bool) -> tuple[Matrix, Vector]:
    """Regressors and target of one segment: y[n] from everything up to n - 1, once the start has passed."""
    y = segment.position
    columns = _basis(y, order, drift)
    if with_surplus:
        columns = np.hstack([columns, _basis(segment.surplus, order, drift)])
    begin = order + 1
    return columns[begin - 1 : -1], y[begin:]


def _without_free_motion(rows: Matrix, target: Vector, drift: float, rest_known: bool) -> tuple[Matrix, Vector]:
    """Rows and target less the drifting and slowing mass, alpha + beta p^n (alpha + beta n where p = 1); and less what
    a constant force adds to it, where rest is not known."""
    n = np.arange(target.size, dtype=float)
    slowing = drift < 1.0 - 1e-12
    motions = [np.ones_like(n), drift**n if slowing else n]
    if not rest_known:
        motions.append(n if slowing else n**2)
    basis = np.column_stack([motion / np.max(np.abs(motion), initial=1e-300) for motion in motions])
    q, r = np.linalg.qr(basis)
    q = q[:, np.abs(np.diag(r)) > 1e-12] if r.shape[0] == r.shape[1] else q
    return rows - q @ (q.T @ rows), target - q @ (q.T @ target)
