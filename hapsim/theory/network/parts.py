"""Which points of a scene hang together."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]


def part_of_each(ends: Indices, points: int) -> Indices:
    """(points,): the same number for the points that links, (L, 2) ends, join, a ground (-1) joining none."""
    parent = list(range(points))

    def part(point: int) -> int:
        while parent[point] != point:
            parent[point] = parent[parent[point]]
            point = parent[point]
        return point

    for a, b in ends[(ends >= 0).all(axis=1)].tolist():
        parent[part(a)] = part(b)
    return np.array([part(point) for point in range(points)], dtype=np.intp)
