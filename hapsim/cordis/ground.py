"""The ground: a point that stays where it is put, and moves only where its rest position is changed.

While it moves, its velocity is felt through the dampers that are tied to it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined


class Grounds(NamedTuple):
    """G grounds, which stand together from point `start` on; `rest`: m, shape (G,)."""

    start: int
    rest: NDArray[np.float64]


@inlined
def settle(grounds, position, previous):
    """Puts every ground to its rest position, and the sample before to where it was."""
    for i in range(grounds.rest.size):
        p = grounds.start + i
        previous[p] = position[p]
        position[p] = grounds.rest[i]
