"""The scene at one sample: what every module reads, and where it leaves its force."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Column = NDArray[np.floating[Any]]
"""Numbers in the scene's precision: one for each point, or for each module of a type."""


class TickState(NamedTuple):
    """N points at sample n. Positions in m, force in N, shape (N,); the arrays are the program's, not copies.

    A program has three of them: its three rows of positions take turns, so that no sample is ever copied.
    """

    position: Column
    """x[n]"""
    previous: Column
    """x[n-1]"""
    following: Column
    """x[n+1], to be written."""
    force: Column
    """Added up during a tick; who uses a force sets it to zero. Nobody uses a ground's."""
    velocity: NDArray[np.float64]
    """(H,) m/s, of the H device points, which come first: what the device senses, 0 where it does not."""
