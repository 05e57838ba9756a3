"""Memory laid out so that a C program is not slowed down by where its arrays happen to stand."""

from __future__ import annotations

from ctypes import POINTER, c_double

import numpy as np
from numpy.typing import NDArray

_LINE = 64
_PAGE = 4096
_APART = 21 * _LINE  # a third of a page, about


def rows(count: int, points: int, at: int = 0) -> list[NDArray[np.float64]]:
    """`count` rows of `points` zeros whose item `at` stands at the begin of a cache line.

    They stand a third of a page apart in their last twelve bits: a processor tells a load from a store before it only
    by these, and waits in vain where they agree.
    """
    spacing = -(-8 * (points + 8) // _PAGE) * _PAGE + _APART
    memory = np.zeros(count * spacing + _LINE, np.uint8)
    begin = (-(memory.ctypes.data + 8 * at)) % _LINE
    return [memory[begin + i * spacing : begin + i * spacing + 8 * points].view(np.float64) for i in range(count)]


def pointer(array: NDArray[np.float64]) -> POINTER(c_double):  # type: ignore[valid-type]
    """Returns a pointer to the first item. The array must be kept as long as the pointer is used."""
    return array.ctypes.data_as(POINTER(c_double))
