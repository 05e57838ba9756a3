"""Every factor of one link's stiffness, or damping, at which a pole of the loop crosses the unit circle.

The change is of rank one: the transition becomes M + s u v'. A pole stands at z where s g(z) = 1 with
g(z) = v'(z - M)^-1 u, and on the circle s is real where g(z) = g(1/z). Since

    (z - M)^-1 - (1/z - M)^-1 = (1/z - z) ((z - M)(1/z - M))^-1,      (z - M)(1/z - M) = A² + y M,

with A = M - 1 and y = 2 - z - 1/z, which is 4 sin²(angle/2) on the circle, the crossings are the zeros of
h(y) = v'(A² + y M)^-1 u between 0 and 4, and z = 1 and z = -1. With P = A² + y0 M and G = P^-1 M the zeros are those y
for which -1/(y - y0) is an eigenvalue of G - P^-1 u v'G/h(y0): as many as the state has numbers, in real arithmetic,
and slow ones to all their digits. The scene's response (``response.py``) gives s there.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.network import Network
from hapsim.theory.network.response import SceneMatrix, on_circle
from hapsim.theory.sample import loop

OUTSIDE = 1e-12  # the circle's radius is 1 and this: poles that rest on 1, and what never loses energy, lie inside
REAL = 1e-6  # of |y|: an imaginary part below this is rounding, or two crossings that nearly meet
SHIFTS = (-0.011, -0.037, -0.13, -0.41)


class Crossings:
    """What all links have in common."""

    def __init__(self, network: Network) -> None:
        change, _, push, _, stretches = loop(network, inputs=True)
        one = np.eye(len(change))
        step = (change - OUTSIDE * one) / (1.0 + OUTSIDE)
        matrix = one + step
        self._response = SceneMatrix(network)
        self._shift = _far_from_poles(matrix)
        shifted = step @ step + self._shift * matrix
        u = _between(push, network)
        self._v = -stretches * np.stack([network.stiffness, network.damping * network.rate])[:, :, None]
        self._reached = np.linalg.solve(shifted, u)
        self._common = np.linalg.solve(shifted, matrix)

    def factors(self, link: int, quantity: int) -> Floats:
        """Positive factors of the link's stiffness (0) or damping (1), ascending: all at which a pole crosses, and some
        at which one only touches the circle."""
        v, reached = self._v[quantity, link], self._reached[:, link]
        at_shift = float(v @ reached)
        angles = np.array([0.0, np.pi])
        if at_shift != 0.0:
            with np.errstate(divide="ignore", invalid="ignore"):
                change = np.outer(reached, v @ self._common / at_shift)
                y = self._shift - 1.0 / np.linalg.eigvals(self._common - change)
                real = (np.abs(y.imag) <= REAL * np.abs(y)) & (y.real > 0.0) & (y.real < 4.0)
            angles = np.append(angles, 2.0 * np.arcsin(0.5 * np.sqrt(y.real[real])))
        change = self._response.changes(on_circle(angles, OUTSIDE), np.array([link]))[quantity, 0]
        factors = 1.0 + change.real
        return np.sort(factors[np.isfinite(factors) & (factors > 0.0)])


def _between(push: Floats, network: Network) -> Floats:
    """(size, L): what a force of 1 N on a link's first end, and the opposite on its second, adds to the state."""
    grounded = np.hstack([push, np.zeros((len(push), 1))])  # a ground, -1, is the last
    return grounded[:, network.ends[:, 0]] - grounded[:, network.ends[:, 1]]


def _far_from_poles(matrix: Floats) -> float:
    """A y below 0 at which no pole stands."""
    poles = np.linalg.eigvals(matrix).astype(complex)
    poles = poles[poles != 0.0]
    y = -((poles - 1.0) ** 2) / poles
    return max(SHIFTS, key=lambda shift: float(np.abs(y / shift - 1.0).min(initial=1.0)))
