"""The arrays that the theory is written in, and the order that poles are listed in."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


def sort_by_modulus(values: Complexes) -> Complexes:
    """Along the last axis, by decreasing modulus; conjugates together, the one above the real axis first."""
    order = np.lexsort((-values.imag, -values.real, -np.abs(values)), axis=-1)
    return np.take_along_axis(values, order, axis=-1)
