"""Every factor of one link's stiffness, or damping, at which a pole of the loop crosses the unit circle.

The change is of rank one: with s u v' added to what a sample adds to the state, A, a pole stands at z where s g(z) = 1
with g(z) = v'(z - M)^-1 u, M = 1 + A, and on the circle s is real where g(z) = g(1/z). Since

    (z - M)^-1 - (1/z - M)^-1 = (1/z - z) ((z - M)(1/z - M))^-1,      (z - M)(1/z - M) = A² + y M,

with y = 2 - z - 1/z, which is 4 sin²(angle/2) on the circle, the crossings are the zeros of h(y) = v'(A² + y M)^-1 u
between 0 and 4, and z = 1 and z = -1. With P = A² + y0 M and G = P^-1 M the zeros are those y for which -1/(y - y0) is
an eigenvalue of G - P^-1 u v'G/h(y0): as many as the state has numbers, in real arithmetic, and slow ones to all their
digits. There s = 1/g.
"""

from __future__ import annotations

from contextlib import suppress
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network.network import Network
from hapsim.theory.rows import Rows, stretches_of, times
from hapsim.theory.sample import loop

OUTSIDE = 1e-12  # the circle's radius is 1 and this: poles that rest on 1, and what never loses energy, lie inside
REAL = 1e-6  # of |y|: an imaginary part below this is rounding, or two crossings that nearly meet
SHIFTS = (-0.011, -0.037, -0.13, -0.41)
AT_ONCE = 4_000_000  # complex numbers in memory


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
    """What all links have in common."""

    def __init__(self, network: Network) -> None:
        self._links = link_changes(network)
        one = np.eye(len(self._links.change))
        step = (self._links.change - OUTSIDE * one) / (1.0 + OUTSIDE)
        matrix = one + step
        self._shift = _far_from_poles(step)
        shifted = step @ step + self._shift * matrix
        self._reached, self._common = 0.0 * self._links.pushed, matrix
        with suppress(np.linalg.LinAlgError):  # numbers too far apart: what is found is looked at anyway
            self._common = np.linalg.solve(shifted, matrix)
            self._reached = np.linalg.solve(shifted, self._links.pushed)

    @np.errstate(all="ignore")
    def factors(self, link: int, quantity: int) -> Floats:
        """Positive factors of the link's stiffness (0) or damping (1), ascending: all at which a pole crosses, and some
        at which one only touches the circle."""
        u, v, reached = self._links.pushed[:, link], self._links.read[quantity][link], self._reached[:, link]
        at_shift = float(v @ reached)
        angles = np.array([0.0, np.pi])
        if at_shift != 0.0:
            change = np.outer(reached, v @ self._common / at_shift)
            y = self._shift - 1.0 / np.linalg.eigvals(self._common - change)
            real = (np.abs(y.imag) <= REAL * np.abs(y)) & (y.real > 0.0) & (y.real < 4.0)
            angles = np.append(angles, 2.0 * np.arcsin(0.5 * np.sqrt(y.real[real])))
        w, step = on_circle(angles, OUTSIDE), max(1, AT_ONCE // u.size**2)
        parts = [w[start : start + step, None, None] for start in range(0, w.size, step)]
        states = np.concatenate([_solved(part * np.eye(u.size) - self._links.change, u) for part in parts])
        factors = 1.0 + (1.0 / (states @ v)).real
        return np.sort(factors[np.isfinite(factors) & (factors > 0.0)])


@np.errstate(all="ignore")  # a pole at 0 is infinitely far
def _far_from_poles(step: Floats) -> float:
    """A y below 0 at which no pole stands."""
    w = np.linalg.eigvals(step).astype(complex)
    y = np.nan_to_num(-(w**2) / (1.0 + w), nan=np.inf)
    return max(SHIFTS, key=lambda shift: float(np.abs(y / shift - 1.0).min(initial=1.0)))


def _solved(matrices: Complexes, u: Floats) -> Complexes:
    """(n, size): NaN where a matrix has no inverse."""
    try:
        return np.asarray(np.linalg.solve(matrices, u[:, None] + 0j))[..., 0]
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full((1, u.size), np.nan, dtype=complex)
        return np.concatenate([_solved(one[None], u) for one in matrices])
