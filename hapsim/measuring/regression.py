"""Closed-loop poles from a record of positions and forces, by one linear regression.

The hand's mass answers to force alone, so between position y, force f and the rounding e of the position stands

    A(q) y[n] = N(q) d[n] + C(q) e[n],      C(q) = (1 - 1/q)(1 - p/q)

A: the closed loop's characteristic polynomial, whose roots are sought; d: what the recorded force has beyond the linear
law of the scene (its rounding, cuts at the limit, an excitation); C: the open loop's, because e goes round the loop
like the position itself and is carried on by a mass that drifts (pole 1) and slows down (pole p). Divided by C, that is
y doubly summed, the equation's error is e itself: white, so ordinary least squares is the maximum-likelihood estimate
and its covariance is honest. Only C's pole p is searched for; order and p are chosen by what the residuals say.

Written with C split off, A = C + (1/q) G(q), nothing cancels: the regressors are sums and differences of y.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.signal import lfilter

Vector = NDArray[np.float64]

_MARGIN = 2.0  # rows per unknown below which a regression says nothing


@dataclass(frozen=True)
class Segment:
    """Consecutive samples of one channel: position in counts from rest, and force beyond the scene's law."""

    position: Vector
    surplus: Vector
    rest_known: bool = True
    """False where the position may be counted from elsewhere than rest: a constant force then stays in the record."""


@dataclass(frozen=True)
class Fit:
    """A fitted A(q): coefficients g of G in the basis of `_basis`, their spread, and how well they fit."""

    order: int
    drift: float
    """p, the open loop's second pole."""
    g: Vector
    spread: NDArray[np.float64]
    """A square root of g's covariance: covariance = spread @ spread.T. Kept so, no variance comes out negative."""
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
    def directions(self) -> NDArray[np.float64]:
        """What one unit of each g adds to the polynomial below its leading term, shape (order, order)."""
        return _directions(self.order, self.drift)


def fit(segments: list[Segment], order: int, drift: float, with_surplus: bool, floor: float) -> Fit | None:
    """Least squares for one order and one p. `floor`: the least error that rounding leaves, in counts. None where the
    record is too short for so many unknowns."""
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
    solution = solve_triangular(r, q.T @ target) / scale
    error = target - matrix @ solution
    variance = float(error @ error) / (count - total)
    half = solve_triangular(r, np.eye(unknowns)) / scale[:, None]
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


def _directions(order: int, drift: float) -> NDArray[np.float64]:
    """Row i: the polynomial of basis function i of `_basis`, in powers 0 to order - 1 of 1/q."""
    rows = np.zeros((order, order))
    step = np.array([1.0, -1.0])
    polynomial = np.array([1.0])
    for i in range(order):
        rows[i, : polynomial.size] = polynomial
        polynomial = _open_loop(drift) if i == 1 else np.convolve(polynomial, step)
    return rows


def _basis(x: Vector, order: int, drift: float) -> NDArray[np.float64]:
    """x doubly summed, summed, x, its first difference, …: shape (samples, order)."""
    slowed = lfilter([1.0], [1.0, -drift], x)
    columns = [np.cumsum(slowed), slowed, x]
    while len(columns) < order:
        columns.append(np.diff(columns[-1], prepend=0.0))
    return np.column_stack(columns[:order])


def _rows(segment: Segment, order: int, drift: float, with_surplus: bool) -> tuple[NDArray[np.float64], Vector]:
    """Regressors and target of one segment: y[n] from everything up to n - 1, once the start has passed."""
    y = segment.position
    columns = _basis(y, order, drift)
    if with_surplus:
        columns = np.hstack([columns, _basis(segment.surplus, order, drift)])
    begin = order + 1
    return columns[begin - 1 : -1], y[begin:]


def _without_free_motion(
    rows: NDArray[np.float64], target: Vector, drift: float, rest_known: bool
) -> tuple[NDArray[np.float64], Vector]:
    """Projects the drifting and slowing mass, alpha + beta p^n (alpha + beta n where p = 1), out of rows and target;
    and what a constant force adds to it, where rest is not known."""
    n = np.arange(target.size, dtype=float)
    slowing = drift < 1.0 - 1e-12
    motions = [np.ones_like(n), drift**n if slowing else n]
    if not rest_known:
        motions.append(n if slowing else n**2)
    basis = np.column_stack([motion / np.max(np.abs(motion), initial=1e-300) for motion in motions])
    q, r = np.linalg.qr(basis)
    q = q[:, np.abs(np.diag(r)) > 1e-12] if r.shape[0] == r.shape[1] else q
    return rows - q @ (q.T @ rows), target - q @ (q.T @ target)
