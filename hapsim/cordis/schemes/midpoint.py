"""The implicit midpoint scheme, for a linear system the trapezoidal rule: stable whatever the stiffness.

    M (v[n+1] - v[n])/T = f[n] - K (x[n] + x[n+1])/2 - B (v[n] + v[n+1])/2,     x[n+1] = x[n] + T (v[n] + v[n+1])/2

With the step w = T v and its change c = w[n+1] - w[n]:

    (M + T/2 B + T²/4 K) c = T² f - T² K (x + w/2) - T B w,       x[n+1] = x + w + c/2

The matrix is factorised once, when the scene is compiled, with its points in an order that keeps it narrow (Cuthill
and McKee); a tick goes through it forth and back. What is not inside (`linear_subsystem.py`) pulls with the force f of
sample n all the way to n + 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, Scheme, Taken
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.schemes.linear_subsystem import (
    LinearSubsystem,
    Ties,
    add_tie_forces,
    external_parts,
    inside,
    linear_subsystem,
    require_finite,
)
from hapsim.errors import UsageError
from hapsim.scene import Scene

MOST_NUMBERS = 20_000_000  # in the factor: 160 MB, and some ten milliseconds a tick

_ONE = np.uint64(1)


class LoadedRows(NamedTuple):
    """The points that something from outside pulls: by number, and by row of the matrices."""

    point: NDArray[np.uint32]
    row: NDArray[np.uint64]


class Diagonals(NamedTuple):
    """A symmetric matrix of n rows by its diagonals: the main one (n,), and those `offset` (D,) below it (D, n)."""

    main: Column
    offset: NDArray[np.uint64]
    below: Column


class Factor(NamedTuple):
    """L D L^T of bandwidth b: one over D (n,); L below its main diagonal by columns and by rows, (n, b) each."""

    inverse: Column
    columns: Column
    rows: Column


class Midpoint(NamedTuple):
    """n rows: the points from number `start` on, or, where it is not empty, those in `order`, the rows' points."""

    start: np.uint64
    order: NDArray[np.uint32]
    force: Column
    """(n,) T² f of what stays, kg·m."""
    period_squared: Column
    """(1,) T² in s²"""
    stiffness: Diagonals
    """T² K, kg"""
    damping: Diagonals
    """T B, kg"""
    factor: Factor
    loaded: LoadedRows
    ties: Ties
    middle: Column
    """(n,) x + w/2, m"""
    step: Column
    """(n,) w, m"""
    change: Column
    """(b + n + b,): what is to be solved, and the solution, with room on both sides."""


@action
def integrate(points, state):
    """Moves every inner point by one sample."""
    points, state = value_of(points), value_of(state)
    add_tie_forces(points.ties, state)
    _read(points, state.position, state.previous)
    band, size = np.uint64(points.factor.columns.shape[1]), np.uint64(points.step.size)
    change = points.change[band : band + size]
    for i in range(size):
        change[i] = points.force[i]
    _subtract(points.stiffness, points.middle, change)
    _subtract(points.damping, points.step, change)
    loaded = points.loaded
    for i in range(np.uint64(loaded.point.size)):
        change[loaded.row[i]] += points.period_squared[0] * state.force[loaded.point[i]]
        state.force[loaded.point[i]] = change.dtype.type(0)
    if band == _ONE:
        _solve_narrow(points.factor, change)
    else:
        _solve(points.factor, points.change)
    _write(points, change, state.position, state.following)


@fma
def _read(points, position, previous):
    """x + w/2 and w of every row."""
    half, order = position.dtype.type(0.5), points.order
    if order.size == 0:
        x, before = position[points.start :], previous[points.start :]
        for i in range(np.uint64(points.step.size)):
            w = x[i] - before[i]
            points.step[i] = w
            points.middle[i] = x[i] + half * w
    else:
        for i in range(np.uint64(points.step.size)):
            w = position[order[i]] - previous[order[i]]
            points.step[i] = w
            points.middle[i] = position[order[i]] + half * w


@fma
def _write(points, change, position, following):
    """The next position, and what becomes the one before it."""
    half, order = position.dtype.type(0.5), points.order
    if order.size == 0:
        x, after = position[points.start :], following[points.start :]
        for i in range(np.uint64(points.step.size)):
            after[i] = x[i] + (points.step[i] + half * change[i])
            x[i] = after[i] - (points.step[i] + change[i])
    else:
        for i in range(np.uint64(points.step.size)):
            following[order[i]] = position[order[i]] + (points.step[i] + half * change[i])
            position[order[i]] = following[order[i]] - (points.step[i] + change[i])


@fma
def _subtract(matrix, vector, out):
    """out -= matrix vector"""
    size = np.uint64(out.size)
    for i in range(size):
        out[i] -= matrix.main[i] * vector[i]
    for d in range(np.uint64(matrix.offset.size)):
        offset, below = matrix.offset[d], matrix.below[d]
        lower_out, lower_vector = out[offset:], vector[offset:]
        for i in range(size - offset):
            out[i] -= below[i] * lower_vector[i]
        for i in range(size - offset):
            lower_out[i] -= below[i] * vector[i]


@fma
def _solve_narrow(factor, x):
    """Solves in place where each row knows its neighbours only."""
    size = np.uint64(x.size)
    carry = x[0]
    for i in range(_ONE, size):
        carry = x[i] - factor.columns[i - _ONE, 0] * carry
        x[i] = carry
    for i in range(size):
        x[i] *= factor.inverse[i]
    carry = x[size - _ONE]
    for i in range(_ONE, size):
        j = size - _ONE - i
        carry = x[j] - factor.columns[j, 0] * carry
        x[j] = carry


@fma
def _solve(factor, padded):
    """Solves in place: `padded` has as many numbers more than rows, on both sides, as the matrix is wide."""
    rows, band = np.uint64(factor.columns.shape[0]), np.uint64(factor.columns.shape[1])
    for i in range(rows):
        here, below, column = padded[band + i], padded[band + i + _ONE : band + i + _ONE + band], factor.columns[i]
        for d in range(band):
            below[d] -= column[d] * here
    for i in range(rows):
        padded[band + i] *= factor.inverse[i]
    for k in range(rows):
        j = rows - _ONE - k
        here, above, row = padded[band + j], padded[j : j + band], factor.rows[j]
        for d in range(band):
            above[d] -= row[d] * here


class _Rows(NamedTuple):
    """Which point each row is of; `row` (n inner points,): where each inner point is; how many rows."""

    order: NDArray[np.uint32]
    row: NDArray[np.intp]
    size: int


def _parts(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    inner = linear_subsystem(scene, context)
    parts = external_parts(context, taken)
    return parts if inner is None else (*parts, Part(_midpoint(inner, context), integrate=integrate))


MIDPOINT = Scheme(_parts, inside)


def _midpoint(inner: LinearSubsystem, context: BuildContext) -> Midpoint:
    square = context.rate * context.rate
    stiffness, damping = inner.stiffness_matrix() / square, inner.damping_matrix() / context.rate
    require_finite(stiffness.data, damping.data, inner.mass)
    rows = _rows_of(inner, abs(stiffness) + abs(damping))
    mass = np.ones(rows.size)
    mass[rows.row] = inner.mass
    force = np.zeros(rows.size)
    force[rows.row] = inner.force / square
    diagonals = [_diagonals(matrix, rows, context) for matrix in (stiffness, damping)]
    factor = _factor(mass, stiffness / 4.0 + damping / 2.0, rows, context)
    middle, step = np.zeros((2, rows.size), context.real)
    return Midpoint(
        start=np.uint64(inner.point[0]),
        order=rows.order,
        force=force.astype(context.real),
        period_squared=np.array([1.0 / square], context.real),
        stiffness=diagonals[0],
        damping=diagonals[1],
        factor=factor,
        loaded=LoadedRows(inner.point[inner.loaded], rows.row[inner.loaded].astype(np.uint64)),
        ties=inner.ties,
        middle=middle,
        step=step,
        change=np.zeros(rows.size + 2 * factor.columns.shape[1], context.real),
    )


def _rows_of(inner: LinearSubsystem, pattern: Any) -> _Rows:
    """The rows in the order of memory, gaps between structures included, or in another where that is much narrower."""
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    in_memory = inner.point.astype(np.intp) - int(inner.point[0])
    permutation = reverse_cuthill_mckee(pattern, symmetric_mode=True)
    narrow = np.empty(inner.point.size, np.intp)
    narrow[permutation] = np.arange(inner.point.size)
    if _band(pattern, in_memory) <= 1.5 * _band(pattern, narrow):
        return _Rows(np.zeros(0, np.uint32), in_memory, int(in_memory[-1]) + 1)
    return _Rows(inner.point[permutation], narrow, inner.point.size)


def _band(pattern: Any, row: NDArray[np.intp]) -> int:
    entries = pattern.tocoo()
    entries.eliminate_zeros()
    return int(np.abs(row[entries.row] - row[entries.col]).max(initial=0))


def _diagonals(matrix: Any, rows: _Rows, context: BuildContext) -> Diagonals:
    entries = matrix.tocoo()
    entries.eliminate_zeros()
    row, column = rows.row[entries.row], rows.row[entries.col]
    main = np.zeros(rows.size)
    main[row[row == column]] = entries.data[row == column]
    lower = row > column
    offset, which = np.unique(row[lower] - column[lower], return_inverse=True)
    below = np.zeros((offset.size, rows.size))
    below[which, column[lower]] = entries.data[lower]
    return Diagonals(main.astype(context.real), offset.astype(np.uint64), below.astype(context.real))


def _factor(mass: NDArray[np.float64], matrix: Any, rows: _Rows, context: BuildContext) -> Factor:
    from scipy.linalg import cholesky_banded

    band = max(_band(matrix, rows.row), 1)
    if band * rows.size > MOST_NUMBERS:
        raise UsageError(
            f"scheme: midpoint would take {band * rows.size:.2g} numbers for this scene, more than {MOST_NUMBERS:.2g}: "
            "its masses are joined too widely; take cordis, semi_implicit or rk4"
        )
    entries = matrix.tocoo()
    row, column = rows.row[entries.row], rows.row[entries.col]
    lower = row >= column
    banded = np.zeros((band + 1, rows.size))
    np.add.at(banded, (row[lower] - column[lower], column[lower]), entries.data[lower])
    banded[0] += mass
    root = cholesky_banded(banded, lower=True)
    columns = np.zeros((rows.size, band))
    by_rows = np.zeros((rows.size, band))
    for d in range(1, band + 1):
        below = root[d, : rows.size - d] / root[0, : rows.size - d]
        columns[: rows.size - d, d - 1] = below
        by_rows[d:, band - d] = below
    return Factor(*(array.astype(context.real) for array in (root[0] ** -2.0, columns, by_rows)))
