"""Every factor of a change of rank one at which a pole of the loop crosses the unit circle.

With s u v' added to what a sample adds to the state, A, a pole stands at z where s g(z) = 1 with g(z) = v'(z - M)^-1 u,
M = 1 + A, and on the circle s is real where g(z) = g(1/z). Since

    (z - M)^-1 - (1/z - M)^-1 = (1/z - z) ((z - M)(1/z - M))^-1,      (z - M)(1/z - M) = A² + y M,

with y = 2 - z - 1/z, which is 4 sin²(angle/2) on the circle, the crossings are the zeros of h(y) = v'(A² + y M)^-1 u
between 0 and 4, and z = 1 and z = -1. With P = A² + y0 M and G = P^-1 M the zeros are those y for which -1/(y - y0) is
an eigenvalue of G - P^-1 u v'G/h(y0): as many as the state has numbers. There x = -(A² + y M)^-1 u gives
g = v'(A + y) x, in real arithmetic, which slow crossings leave all their digits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network.network import Network
from hapsim.theory.rows import Rows, stretches_of, times
from hapsim.theory.sample import loop

OUTSIDE = 1e-12  # the circle's radius is 1 and this: poles that rest on 1, and what never loses energy, lie inside
REAL = 1e-6  # of |y|: an imaginary part below this is rounding, or two crossings that nearly meet
SHIFTS = np.array([-0.011, -0.037, -0.13, -0.41])
AT_ENDS = np.array([1e-22, 4.0 * (1.0 - 1e-14)])  # z = 1 and z = -1, where a pole may stand as it is
AT_ONCE = 4_000_000  # numbers in memory


class LinkChanges(NamedTuple):
    """A link's stiffness or damping, 1 + s times itself, adds s ``pushed`` ``read``' to ``change``: ``pushed``
    (size, L), and ``read``, both (L, size), of stiffness and of damping."""

    change: Rows
    pushed: Rows
    read: tuple[Rows, Rows]


def link_changes(network: Network, sparse: bool = False) -> LinkChanges:
    """Of a scene whose points CORDIS's scheme moves once a sample."""
    change, _, push, _, (stretch, rate) = loop(network, inputs=True, sparse=sparse)
    read = times(-network.stiffness, stretch), times(-network.damping * network.rate, rate)
    return LinkChanges(change, push @ stretches_of(network, sparse).T, read)


def on_circle(angle: Floats, outside: float = 0.0) -> Complexes:
    """w = z - 1, to all its digits, at these angles on a circle whose radius is 1 and ``outside``."""
    return np.asarray(outside * np.exp(1j * angle) - 2.0 * np.sin(0.5 * angle) ** 2 + 1j * np.sin(angle))


class Crossings:
    """What all changes of rank one have in common; ``step``: A, (n, n) or of several loops (N, n, n)."""

    def __init__(self, step: Floats) -> None:
        self._step, self._square, self._matrix = step, step @ step, step + np.eye(step.shape[-1])
        self._shift = _far_from_poles(step)[..., None]
        self._inverse = np.linalg.inv(self._square + self._shift[..., None] * self._matrix)
        self._common = self._inverse @ self._matrix

    @np.errstate(all="ignore")  # what is out of range becomes NaN
    def factors(self, u: Floats, v: Floats) -> Floats:
        """(..., n + 2): all s at which a pole crosses, some at which one only touches the circle, and NaN; the last two
        of z = 1 and z = -1."""
        reached = self._inverse @ u
        change = reached[..., None] * (v @ self._common / (reached @ v)[..., None])[..., None, :]
        y = self._shift - 1.0 / np.linalg.eigvals(self._common - np.nan_to_num(change, posinf=0.0, neginf=0.0))
        real = (np.abs(y.imag) <= REAL * np.abs(y)) & (y.real > 0.0) & (y.real < AT_ENDS[1])
        y = np.concatenate([np.where(real, y.real, np.nan), np.broadcast_to(AT_ENDS, (*y.shape[:-1], 2))], axis=-1)
        found, (*loops, which) = np.full(y.shape, np.nan), np.nonzero(np.isfinite(y))
        some = max(1, AT_ONCE // u.size**2)
        for start in range(0, which.size, some):
            of = tuple(index[start : start + some] for index in loops)
            at = (*of, which[start : start + some])
            x = -_solved(self._square[of] + y[at][:, None, None] * self._matrix[of], u)
            # Both sums of the circle's pair are 0 at a zero of h; z = -1 is a pair by itself.
            slope = y[at] - 2.0 * (at[-1] == y.shape[-1] - 1)
            found[at] = 1.0 / ((x * (v @ self._step[of])).sum(axis=-1) + slope * (x @ v))
        return np.where(np.isfinite(found), found, np.nan)


@np.errstate(all="ignore")  # a pole at 0 is infinitely far
def _far_from_poles(step: Floats) -> Floats:
    """A y below 0 at which no pole stands, of each loop."""
    w = np.linalg.eigvals(step).astype(complex)
    y = np.nan_to_num(-(w**2) / (1.0 + w), nan=np.inf)
    apart = np.abs(y[..., None, :] / SHIFTS[:, None] - 1.0).min(axis=-1, initial=1.0)
    return SHIFTS[np.argmax(apart, axis=-1)]


def _solved(matrices: Floats, u: Floats) -> Floats:
    """(n, size): NaN where a matrix has no inverse."""
    try:
        return np.asarray(np.linalg.solve(matrices, u[:, None]))[..., 0]
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full((1, u.size), np.nan)
        return np.concatenate([_solved(one[None], u) for one in matrices])
