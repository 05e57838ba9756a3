"""The implicit midpoint scheme, for a linear system the trapezoidal rule: stable whatever the stiffness.

    M (v[n+1] - v[n])/T = f[n] - K (x[n] + x[n+1])/2 - B (v[n] + v[n+1])/2,     x[n+1] = x[n] + T (v[n] + v[n+1])/2

With the step w = T v and its change c = w[n+1] - w[n]:

    (M + T/2 B + T²/4 K) c = T² f - T² K (x + w/2) - T B w,       x[n+1] = x + w + c/2

The matrix is factorised once, when the scene is compiled, with its points in an order that keeps it narrow (Cuthill
and McKee); a tick solves it forwards and backwards. Forces from outside (`linear_subsystem.py`) are held from sample n
to n + 1.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.cordis.schemes.linear_subsystem import (
    TOO_LARGE,
    LinearSubsystem,
    Ties,
    add_tie_forces,
    matrix_scheme,
    require_finite,
)
from hapsim.errors import UsageError

MOST_NUMBERS = 20_000_000  # in the factor: 160 MB, and some ten milliseconds a tick

_ONE = np.uint64(1)


class LoadedRows(NamedTuple):
    """The points with a force from outside: by number, and by row of the matrices."""

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
    """n rows, each a point's.

    Attributes:
        point, in_row: (n,) by number; 1 if they are adjacent in memory, which is faster.
        force: (n,) T² f of constant forces, kg·m.
        period_squared: (1,) T² in s².
        stiffness, damping: T² K and T B, kg.
        middle, step: (n,) x + w/2 and w, m.
        change: (b + n + b,): right-hand side and then the solution, with room on both sides.
    """

    point: NDArray[np.uint32]
    in_row: np.uint64
    force: Column
    period_squared: Column
    stiffness: Diagonals
    damping: Diagonals
    factor: Factor
    loaded: LoadedRows
    ties: Ties
    middle: Column
    step: Column
    change: Column


@action
def integrate(points, state):
    """Moves every inner point by one sample."""
    points, state = value_of(points), value_of(state)
    add_tie_forces(points.ties, state)
    band, size = np.uint64(points.factor.columns.shape[1]), np.uint64(points.step.size)
    change = points.change[band : band + size]
    _read(points.point, points.in_row, state.position, state.previous, points.step, points.middle)
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
    _write(points.point, points.in_row, points.step, change, state.position, state.previous)


@fma
def _read(point, in_row, position, previous, step, middle):
    """Computes w and x + w/2 of every row."""
    half, first = position.dtype.type(0.5), np.uint64(point[0])
    for i in range(np.uint64(point.size)):
        p = first + i if in_row else np.uint64(point[i])
        w = position[p] - previous[p]
        step[i] = w
        middle[i] = position[p] + half * w


@fma
def _write(point, in_row, step, change, position, previous):
    """Writes the next positions, and those one step w before them."""
    half, first = position.dtype.type(0.5), np.uint64(point[0])
    for i in range(np.uint64(point.size)):
        p = first + i if in_row else np.uint64(point[i])
        after = position[p] + (step[i] + half * change[i])
        previous[p] = after
        position[p] = after - (step[i] + change[i])


@fma
def _subtract(matrix, vector, out):
    """Computes out -= matrix vector."""
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
    """Solves a tridiagonal system in place."""
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
    """Solves in place. `padded`: the rows, with as many more numbers on both sides as the matrix's bandwidth."""
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


def _part(inner: LinearSubsystem, context: BuildContext) -> Batch:
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    square = context.rate * context.rate
    stiffness = inner.matrix_of(inner.stiffness) / square
    damping = inner.matrix_of(inner.damping) / context.rate
    require_finite(stiffness.data, damping.data, inner.mass)
    pattern = abs(stiffness) + abs(damping)
    order = reverse_cuthill_mckee(pattern, symmetric_mode=True)
    if _band(pattern) <= 1.5 * _band(pattern[order][:, order]):
        order = np.arange(inner.point.size)
    mass = inner.mass[order]
    stiffness, damping = stiffness[order][:, order], damping[order][:, order]
    factor = _factor(mass, stiffness / 4.0 + damping / 2.0, context)
    loaded = np.argsort(order)[inner.loaded]
    middle, step = np.zeros((2, mass.size), context.real)
    numbers = Midpoint(
        point=inner.point[order],
        in_row=np.uint64(np.all(np.diff(inner.point[order].astype(np.int64)) == 1)),
        force=context.column(inner.force[order] / square),
        period_squared=context.column([1.0 / square]),
        stiffness=_diagonals(stiffness, context),
        damping=_diagonals(damping, context),
        factor=factor,
        loaded=LoadedRows(inner.point[inner.loaded], loaded.astype(np.uint64)),
        ties=inner.ties,
        middle=middle,
        step=step,
        change=np.zeros(mass.size + 2 * factor.columns.shape[1], context.real),
    )
    return Batch(numbers, integrate=integrate)


def _lower(matrix: Any) -> tuple[NDArray[np.intp], NDArray[np.intp], NDArray[np.float64]]:
    """Returns the entries of a lower half: rows below the main diagonal, column, value."""
    entries = matrix.tocoo()
    entries.eliminate_zeros()
    lower = entries.row >= entries.col
    return (entries.row - entries.col)[lower], entries.col[lower], entries.data[lower]


def _band(matrix: Any) -> int:
    return int(_lower(matrix)[0].max(initial=1))


def _diagonals(matrix: Any, context: BuildContext) -> Diagonals:
    below, column, data = _lower(matrix)
    offset, which = np.unique(np.append(0, below), return_inverse=True)
    diagonals = np.zeros((offset.size, matrix.shape[0]))
    diagonals[which[1:], column] = data
    return Diagonals(context.column(diagonals[0]), offset[1:].astype(np.uint64), context.column(diagonals[1:]))


def _factor(mass: NDArray[np.float64], matrix: Any, context: BuildContext) -> Factor:
    from scipy.linalg import cholesky_banded

    below, column, data = _lower(matrix)
    size, band = mass.size, _band(matrix)
    if band * size > MOST_NUMBERS:
        raise UsageError(
            f"scheme: midpoint would take {band * size:.2g} numbers for this scene, more than {MOST_NUMBERS:.2g}: "
            "its masses are joined too widely; take cordis, semi_implicit or rk4"
        )
    banded = np.zeros((band + 1, size))
    banded[below, column] = data
    banded[0] += mass
    try:
        root = cholesky_banded(banded, lower=True)
    except np.linalg.LinAlgError:  # by rounding: its exact value is positive definite
        raise UsageError(TOO_LARGE) from None
    columns, rows = np.zeros((2, size, band))
    for d in range(1, band + 1):
        columns[: size - d, d - 1] = rows[d:, band - d] = root[d, : size - d] / root[0, : size - d]
    return Factor(*map(context.column, (root[0] ** -2.0, columns, rows)))


MIDPOINT = matrix_scheme(_part)
