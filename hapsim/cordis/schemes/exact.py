"""The exact solution of the linear subsystem (`linear_subsystem.py`), with the force from outside held from n to n + 1.

    M x'' + B x' + K x = f[n]      for n T <= t < (n + 1) T

Where one change of coordinates makes K and B diagonal at once, each of them a motion by itself, in O(n) for each point
that something from outside holds (`exact_modes.py`); otherwise as one dense matrix: with w = T v, z = (x, w),

    z[n+1] = E z[n] + D f[n],      E = exp(A), D the integral of exp(A t) over one sample period.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import reassociated
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, Scheme, Taken
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.schemes.exact_modes import modes_of, modes_part
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

MOST_MODES = 4000  # whose shapes take some 15 s to be worked out
MOST_POINTS = 1000  # whose matrix is 32 MB, and some milliseconds a tick


class ExactDense(NamedTuple):
    """n points (n,), of which something from outside pulls P, `loaded` (P,); by number.

    Attributes:
        matrix: (2 n, 2 n + P + 1) what positions, steps, forces and 1 do to positions and steps.
        state, next: (2 n + P + 1,) these; (2 n,) positions and steps of the next sample.
    """

    point: NDArray[np.uint32]
    loaded: NDArray[np.uint32]
    matrix: Column
    state: Column
    next: Column
    ties: Ties


@action
def integrate(points, state):
    """Moves every inner point by one sample."""
    points, state = value_of(points), value_of(state)
    add_tie_forces(points.ties, state)
    n = np.uint64(points.point.size)
    for h in range(np.uint64(points.loaded.size)):
        points.state[n + n + h] = state.force[points.loaded[h]]
        state.force[points.loaded[h]] = points.state.dtype.type(0)
    for i in range(n + n):
        points.next[i] = _row(points.matrix[i], points.state)
    for i in range(n + n):
        points.state[i] = points.next[i]
    for i in range(n):
        state.previous[points.point[i]] = points.state[i]
        state.position[points.point[i]] = points.state[i] - points.state[n + i]


@action
def resume(points, state):
    """Goes on from where the points are, and were."""
    points, state = value_of(points), value_of(state)
    n = np.uint64(points.point.size)
    for i in range(n):
        p = points.point[i]
        points.state[i] = state.position[p]
        points.state[n + i] = state.position[p] - state.previous[p]


@reassociated
def _row(row, state):
    total = row.dtype.type(0)
    for j in range(np.uint64(row.size)):
        total += row[j] * state[j]
    return total


def _dense_part(inner: LinearSubsystem, context: BuildContext) -> Part:
    """The part of the program that moves the subsystem as one."""
    from scipy.linalg import expm

    n, h = inner.point.size, inner.loaded.size
    if n > MOST_POINTS:
        raise UsageError(
            f"scheme: exact is for {MOST_POINTS} masses at most where damping joins the scene's modes, and this one "
            f"moves {n}: make the damping proportional to stiffness or to mass, or take midpoint"
        )
    inertia = 1.0 / (inner.mass * context.rate * context.rate)
    # Steps are measured in units of the fastest motion, so that no part of the matrix dwarfs the others.
    stiffness = inertia[:, None] * inner.stiffness_matrix().toarray()
    scale = max(1.0, float(np.sqrt(np.abs(stiffness).sum(axis=1).max(initial=0.0))))
    a = np.zeros((2 * n + h + 1, 2 * n + h + 1))
    a[:n, n : 2 * n] = scale * np.eye(n)
    a[n : 2 * n, :n] = -stiffness / scale
    a[n : 2 * n, n : 2 * n] = -inertia[:, None] * inner.damping_matrix().toarray() * context.rate
    a[n + inner.loaded, 2 * n + np.arange(h)] = inertia[inner.loaded] / scale
    a[n : 2 * n, -1] = inertia * inner.force / scale
    require_finite(a)
    matrix = expm(a)[: 2 * n]
    matrix[n:] *= scale
    matrix[:, n : 2 * n] /= scale
    require_finite(matrix)
    state = np.concatenate([inner.position, inner.velocity / context.rate, np.zeros(h), [1.0]])
    matrix, state, after = (context.column(values) for values in (matrix, state, np.zeros(2 * n)))
    numbers = ExactDense(inner.point, inner.point[inner.loaded], matrix, state, after, inner.ties)
    return Part(numbers, integrate=integrate, resume=resume)


def _parts(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    inner = linear_subsystem(scene, context)
    parts = external_parts(context, taken)
    if inner is None:
        return parts
    if inner.point.size > MOST_MODES:
        raise UsageError(
            f"scheme: exact is for {MOST_MODES} masses at most, and this scene moves {inner.point.size}: take "
            "midpoint, which is stable whatever the stiffness too"
        )
    scale = 1.0 / np.sqrt(inner.mass) / context.rate
    require_finite(scale, inner.links.stiffness * scale.max() ** 2, inner.links.damping * scale.max() ** 2)
    modes = modes_of(inner, context)
    return (*parts, _dense_part(inner, context) if modes is None else modes_part(inner, modes, context))


EXACT = Scheme(_parts, inside)
