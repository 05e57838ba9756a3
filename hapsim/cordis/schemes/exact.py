"""The exact solution of the linear subsystem (`linear_subsystem.py`), with the force from outside held from n to n + 1.

    M x'' + B x' + K x = f[n]      for n T <= t < (n + 1) T

If one change of coordinates makes both K and B diagonal, each mode moves by itself (`ExactModes`), in O(n) for each
point with a force from outside. With x = S q, S^T M S = 1 and diagonal S^T K S and S^T B S (as for proportional
damping), each mode is an oscillator q'' + b q' + k q = g of unit mass. With p = T q' its step is

    q[n+1] = e11 q + e12 p + d1 g,      p[n+1] = e21 q + e22 p + d2 g,     g = S^T f

A sample computes the positions of points with a force from outside only; the others are hidden.

Otherwise one dense matrix moves all points (`ExactDense`): with w = T v, z = (x, w),

    z[n+1] = E z[n] + D f[n],      E = exp(A), D the integral of exp(A t) over one sample period.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, reassociated
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.cordis.schemes.linear_subsystem import LinearSubsystem, Ties, add_tie_forces, matrix_scheme, require_finite
from hapsim.errors import UsageError

MOST_MODES = 4000  # their shapes take some 15 s to compute
MOST_POINTS = 1000  # their matrix is 32 MB, and takes some milliseconds per tick
DIAGONAL = 1e-9  # largest off-diagonal element of modes, relative to the largest element

Reals = NDArray[np.float64]


class ExactDense(NamedTuple):
    """n points (n,), P of which have a force from outside, `loaded` (P,); by number.

    Attributes:
        matrix: (2 n, 2 n + P + 1) from positions, steps, forces and 1 to positions and steps.
        state, next: (2 n + P + 1,) the former; (2 n,) positions and steps of the next sample.
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
        points.next[i] = _sum(points.matrix[i], points.state)
    for i in range(n + n):
        points.state[i] = points.next[i]
    for i in range(n):
        state.previous[points.point[i]] = points.state[i]
        state.position[points.point[i]] = points.state[i] - points.state[n + i]


@action
def resume(points, state):
    """Sets the state from the points' positions of both samples."""
    points, state = value_of(points), value_of(state)
    n = np.uint64(points.point.size)
    for i in range(n):
        p = points.point[i]
        points.state[i] = state.position[p]
        points.state[n + i] = state.position[p] - state.previous[p]


def _dense_part(inner: LinearSubsystem, context: BuildContext) -> Batch:
    """Returns the part that moves the subsystem by one matrix. Raises UsageError for too many points."""
    from scipy.linalg import expm

    n, h = inner.point.size, inner.loaded.size
    if n > MOST_POINTS:
        raise UsageError(
            f"scheme: exact is for {MOST_POINTS} masses at most where damping joins the scene's modes, and this one "
            f"moves {n}: make the damping proportional to stiffness or to mass, or take midpoint"
        )
    inertia = 1.0 / (inner.mass * context.rate * context.rate)
    # Steps are measured in units of the fastest motion, so that no part of the matrix dwarfs the others.
    stiffness = inertia[:, None] * inner.matrix_of(inner.stiffness).toarray()
    scale = max(1.0, float(np.sqrt(np.abs(stiffness).sum(axis=1).max(initial=0.0))))
    a = np.zeros((2 * n + h + 1, 2 * n + h + 1))
    a[:n, n : 2 * n] = scale * np.eye(n)
    a[n : 2 * n, :n] = -stiffness / scale
    a[n : 2 * n, n : 2 * n] = -inertia[:, None] * inner.matrix_of(inner.damping).toarray() * context.rate
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
    return Batch(numbers, integrate=integrate, resume=resume)


class Modes(NamedTuple):
    """`shape` (n, n): x = shape q, a column a mode; (n,) k T² and b T."""

    shape: Reals
    stiffness: Reals
    damping: Reals


class ExactModes(NamedTuple):
    """n modes of n points, P of which have a force from outside.

    Attributes:
        point, hidden: (P,) those by number; (n - P,) the others.
        shape, hidden_shape: (P, n), (n - P, n) motion of each by mode j.
        mass: (n,) kg, of the former and then of the latter.
        constant, push: (n,) T² g of constant forces; of all forces.
        gain: (6, n) e11, e12, e21, e22, d1, d2.
        position, step, after: (n,) q, p, and q of the next sample.
        period_squared: (1,) T² in s².
    """

    point: NDArray[np.uint32]
    shape: Column
    hidden: NDArray[np.uint32]
    hidden_shape: Column
    mass: Column
    constant: Column
    gain: Column
    position: Column
    step: Column
    push: Column
    after: Column
    period_squared: Column
    ties: Ties


@action
def integrate_modes(modes, state):
    """Moves every mode by one sample, and writes the positions of points with a force from outside."""
    modes, state = value_of(modes), value_of(state)
    add_tie_forces(modes.ties, state)
    for j in range(np.uint64(modes.push.size)):
        modes.push[j] = modes.constant[j]
    for h in range(np.uint64(modes.point.size)):
        p = modes.point[h]
        _push(modes.push, modes.shape[h], modes.period_squared[0] * state.force[p])
        state.force[p] = modes.push.dtype.type(0)
    _advance(modes.gain, modes.position, modes.step, modes.push, modes.after)
    for h in range(np.uint64(modes.point.size)):
        p = modes.point[h]
        x = _sum(modes.shape[h], modes.position)
        state.previous[p] = x
        state.position[p] = x - _sum(modes.shape[h], modes.step)


@action
def place_modes(modes, state):
    """Writes the positions of the hidden points."""
    modes, state = value_of(modes), value_of(state)
    for h in range(np.uint64(modes.hidden.size)):
        x = _sum(modes.hidden_shape[h], modes.position)
        state.position[modes.hidden[h]] = x
        state.previous[modes.hidden[h]] = x - _sum(modes.hidden_shape[h], modes.step)


@action
def resume_modes(modes, state):
    """Sets the modes from the points' positions of both samples: q = S^T M x."""
    modes, state = value_of(modes), value_of(state)
    for j in range(np.uint64(modes.position.size)):
        modes.position[j] = modes.step[j] = modes.mass.dtype.type(0)
    loaded = np.uint64(modes.point.size)
    for h in range(np.uint64(modes.mass.size)):
        p = modes.point[h] if h < loaded else modes.hidden[h - loaded]
        shape = modes.shape[h] if h < loaded else modes.hidden_shape[h - loaded]
        x = state.position[p]
        _push(modes.position, shape, modes.mass[h] * x)
        _push(modes.step, shape, modes.mass[h] * (x - state.previous[p]))


@fma
def _push(push, shape, force):
    for j in range(np.uint64(push.size)):
        push[j] += shape[j] * force


@fma
def _advance(gain, position, step, push, after):
    """Moves the modes by a sample. One loop for each written array: with more, the compiler cannot rule out an overlap,
    and does not vectorise."""
    modes = np.uint64(position.size)
    e11, e12, d1 = gain[0], gain[1], gain[4]
    for j in range(modes):
        after[j] = e11[j] * position[j] + e12[j] * step[j] + d1[j] * push[j]
    e21, e22, d2 = gain[2], gain[3], gain[5]
    for j in range(modes):
        step[j] = e21[j] * position[j] + e22[j] * step[j] + d2[j] * push[j]
    for j in range(modes):
        position[j] = after[j]


@reassociated
def _sum(shape, motion):
    total = shape.dtype.type(0)
    for j in range(np.uint64(shape.size)):
        total += shape[j] * motion[j]
    return total


def modes_of(inner: LinearSubsystem, context: BuildContext) -> Modes | None:
    """Returns the modes of the subsystem; None if damping couples them."""
    root = 1.0 / (np.sqrt(inner.mass) * context.rate)
    stiffness = root[:, None] * inner.matrix_of(inner.stiffness).toarray() * root
    damping = root[:, None] * inner.matrix_of(inner.damping).toarray() * root * context.rate
    require_finite(stiffness, damping)
    scaled = [matrix / (float(np.abs(matrix).max(initial=0.0)) or 1.0) for matrix in (stiffness, damping)]
    for share in (0.0, 0.5, 0.3819660112501051):  # if K alone has equal modes, K and B together separate them
        vectors = np.linalg.eigh(scaled[0] + share * scaled[1])[1]
        rotated = [vectors.T @ matrix @ vectors for matrix in scaled]
        if all(np.abs(one - np.diag(np.diag(one))).max(initial=0.0) <= DIAGONAL for one in rotated):
            return _refined(inner, vectors * root[:, None] * context.rate, context)
    return None


def _refined(inner: LinearSubsystem, shape: Reals, context: BuildContext) -> Modes:
    """Returns the modes with k and b summed over all links by the mode's stretches. Unlike eigenvalues, these are as
    accurate for slow modes as for fast ones."""
    squares = (inner.stretches() @ shape) ** 2
    stiffness = inner.stiffness @ squares / (context.rate * context.rate)
    damping = inner.damping @ squares / context.rate
    return Modes(shape, np.maximum(stiffness, 0.0), np.maximum(damping, 0.0))


def _modes_part(inner: LinearSubsystem, modes: Modes, context: BuildContext) -> Batch:
    """Returns the part of the program that moves these modes."""
    momentum, column = modes.shape.T * inner.mass, context.column
    hidden = np.setdiff1d(np.arange(inner.point.size, dtype=np.uint32), inner.loaded)
    push, after = np.zeros((2, modes.stiffness.size), context.real)
    square = context.rate * context.rate
    numbers = ExactModes(
        point=inner.point[inner.loaded],
        shape=column(np.ascontiguousarray(modes.shape[inner.loaded])),
        hidden=inner.point[hidden],
        hidden_shape=column(np.ascontiguousarray(modes.shape[hidden])),
        mass=column(np.concatenate([inner.mass[inner.loaded], inner.mass[hidden]])),
        constant=column(modes.shape.T @ inner.force / square),
        gain=column(_gains(modes.stiffness, modes.damping)),
        position=column(momentum @ inner.position),
        step=column(momentum @ inner.velocity / context.rate),
        push=push,
        after=after,
        period_squared=column([1.0 / square]),
        ties=inner.ties,
    )
    return Batch(numbers, integrate=integrate_modes, place=place_modes, resume=resume_modes)


def _gains(k: Reals, b: Reals) -> Reals:
    """Returns (6, n) e11, e12, e21, e22, d1, d2 of the oscillators q'' + b q' + k q = g over a time of 1. They decay as
    exp(-slow t) and exp(-fast t), two rates that are complex where they oscillate."""
    root = np.sqrt(0.25 * b * b - k + 0j)
    fast = 0.5 * b + root
    slow = np.divide(k, fast, out=np.zeros_like(fast), where=fast != 0.0)  # no difference of two large numbers
    sine = (np.exp(-slow) * _mean(2.0 * root)).real
    cosine = 0.5 * (np.exp(-slow) + np.exp(-fast)).real
    e11 = cosine + 0.5 * b * sine
    # d1: q after a time of 1 from rest under g = 1. For slow motions q = sum a_m t^m with a_2 = 1/2 and
    # (m+2)(m+1) a_(m+2) = -b (m+1) a_(m+1) - k a_m.
    is_slow = (k < 1.0) & (b < 4.0)
    older, newer, lag = np.zeros_like(k), np.full_like(k, 0.5), np.full_like(k, 0.5)
    for m in range(1, 60):
        following = (-b * (m + 1) * newer - k * older) / ((m + 2) * (m + 1))
        older, newer = newer, np.where(is_slow, following, 0.0)
        lag += newer
    is_braked = ~is_slow & (k < 1e-3 * b * b)
    np.divide(1.0 - e11, k, out=lag, where=~is_slow & ~is_braked)
    np.divide((_mean(slow) - _mean(fast)).real, 2.0 * root.real, out=lag, where=is_braked)
    return np.array([e11, sine, -k * sine, cosine - 0.5 * b * sine, lag, sine])


def _mean(rate: Any) -> Any:
    """Returns the mean of exp(-rate t) from 0 to 1."""
    return np.divide(-np.expm1(-rate), rate, out=np.ones_like(rate), where=rate != 0.0)


def _part(inner: LinearSubsystem, context: BuildContext) -> Batch:
    if inner.point.size > MOST_MODES:
        raise UsageError(
            f"scheme: exact is for {MOST_MODES} masses at most, and this scene moves {inner.point.size}: take "
            "midpoint, which is stable whatever the stiffness too"
        )
    scale = 1.0 / np.sqrt(inner.mass) / context.rate
    require_finite(scale, inner.stiffness * scale.max() ** 2, inner.damping * scale.max() ** 2)
    modes = modes_of(inner, context)
    return _dense_part(inner, context) if modes is None else _modes_part(inner, modes, context)


EXACT = matrix_scheme(_part)
