"""Sparse matrices: their entries as triplets (row, column, value), their inverse, and on how many threads."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Floats, Indices

Solve = Callable[[NDArray], NDArray]


class Triplets(NamedTuple):
    """A matrix (rows, columns) as its entries; entries of one place add up."""

    row: Indices
    column: Indices
    value: Floats

    def gathered(self, columns: int) -> Triplets:
        """The same, one entry a place."""
        place, entry = np.unique(self.row * columns + self.column, return_inverse=True)
        value: Floats = np.bincount(entry, self.value, place.size).astype(float)
        return Triplets(place // columns, place % columns, value)

    def some(self, which: Bools) -> Triplets:
        """The entries at which ``which`` is True."""
        return Triplets(self.row[which], self.column[which], self.value[which])


class TripletBuilder:
    """Collects entries, a block at a time."""

    def __init__(self) -> None:
        self._parts: list[tuple[Indices, Indices, Floats]] = []

    def add(self, row: Indices | int, column: Indices | int, value: Floats | float) -> None:
        """Adds entries, broadcast against each other."""
        rows, columns, values = np.broadcast_arrays(row, column, value)
        self._parts.append((rows.ravel(), columns.ravel(), values.ravel().astype(float)))

    def add_difference(self, row: Indices, first: Indices, second: Indices, value: Floats | float = 1.0) -> None:
        """Adds ``value`` times the first column minus the second; a column below 0 is none."""
        for column, sign in ((first, 1.0), (second, -1.0)):
            met = column >= 0
            self.add(row[met], column[met], sign * np.broadcast_to(value, column.shape)[met])

    def joined(self) -> Triplets:
        """All entries."""
        if not self._parts:
            return Triplets(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros(0))
        row, column, value = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        return Triplets(row, column, value)


def dense(entries: Triplets, shape: tuple[int, int]) -> Floats:
    """The matrix as an array."""
    matrix = np.zeros(shape)
    np.add.at(matrix, (entries.row, entries.column), entries.value)
    return matrix


def sparse(entries: Triplets, shape: tuple[int, int]) -> Any:
    """The matrix as one of scipy's, by compressed columns."""
    import scipy.sparse

    return scipy.sparse.csc_matrix((entries.value, (entries.row, entries.column)), shape)


def factorised(matrix: Any, **how: Any) -> Solve | None:
    """x -> matrix^-1 x; None where there is no inverse. ``how``: as for scipy's ``splu``."""
    from scipy.sparse import linalg

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            solve: Solve = linalg.splu(matrix.tocsc(), **how).solve
        except RuntimeError:
            return None
    return solve
