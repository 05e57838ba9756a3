"""The integrals of a decaying exponential that every exact step of a mass with friction is made of.

    phi_0(u) = e^-u,   phi_n(u) = (1/(n-1)! - phi_(n-1)(u)) / u = sum over j of (-u)^j / (j + n)!

They stay finite and smooth as the friction goes to zero, so that no friction and hardly any friction are one
code.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Floats

SERIES_BELOW = 1.0  # above it the recurrence loses less than one digit, up to order 3
SERIES_TERMS = 20


def phi(order: int, u: ArrayLike) -> Floats:
    """phi_order(u) for u >= 0, order 0 to 3, to a few units of rounding; same shape as u."""
    u = np.asarray(u, dtype=float)
    series = np.zeros_like(u)
    small = np.minimum(u, SERIES_BELOW)
    for j in reversed(range(SERIES_TERMS)):
        series = series * -small + 1.0 / math.factorial(j + order)

    large = np.maximum(u, SERIES_BELOW)
    closed = np.exp(-large)
    for n in range(1, order + 1):
        closed = (1.0 / math.factorial(n - 1) - closed) / large
    return np.where(u < SERIES_BELOW, series, closed)
