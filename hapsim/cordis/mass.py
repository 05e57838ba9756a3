"""The mass: second-order centred scheme (Florens et al., §6, Figure 5a).

(m / T²) (x[n+1] - 2 x[n] + x[n-1]) = F[n]
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined


class Masses(NamedTuple):
    """M masses, which stand together from point `start` on; `mobility`: T²/m in m/N, shape (M,)."""

    start: int
    mobility: NDArray[np.float64]


def masses(start: int, mass: Sequence[float], rate: float) -> Masses:
    """Masses in kg that stand from point `start` on, sampled at `rate` Hz."""
    with np.errstate(over="ignore", divide="ignore"):  # the guard sees what comes of an infinity
        return Masses(start, 1.0 / (np.array(mass, np.float64) * rate * rate))


@inlined
def advance(group, position, previous, force):
    """Moves every mass by one sample."""
    if group is None:
        return
    for i in range(group.mobility.size):
        p = group.start + i
        following = 2.0 * position[p] - previous[p] + group.mobility[i] * force[p]
        previous[p] = position[p]
        position[p] = following
