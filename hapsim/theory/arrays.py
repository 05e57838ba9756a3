"""The arrays that the theory is written in, the order that poles are listed in, and arguments that are refused."""

from __future__ import annotations

import math
from collections.abc import Collection
from typing import Any

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


def positive(name: str, value: Any) -> float:
    """``value`` as a float; ValueError where it is not one finite number greater than zero."""
    number = _finite(name, value)
    if number <= 0.0:
        raise ValueError(f"{name} is {number:g}, but it has to be greater than zero.")
    return number


def not_negative(name: str, value: Any) -> float:
    """``value`` as a float; ValueError where it is not one finite number, zero or greater."""
    number = _finite(name, value)
    if number < 0.0:
        raise ValueError(f"{name} is {number:g}, but it cannot be negative.")
    return number


def _finite(name: str, value: Any) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{name} is {value!r}, but it has to be one number.") from None
    if not math.isfinite(number):
        raise ValueError(f"{name} is {number:g}, but it has to be finite.")
    return number


def one_of(name: str, value: Any, known: Collection[str]) -> str:
    """``value``; ValueError that lists the known names where it is none of them."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} is {value!r}, but it has to be one of: {', '.join(known)}.")
    return value


def vector(
    name: str, value: Any, size: int | None = None, *, least: float = -math.inf, above: float = -math.inf
) -> Floats:
    """``value`` as an array (size,); ValueError where it is not, or an element is out of range."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} has to be an array of numbers.") from None
    if array.ndim != 1 or (size is not None and array.size != size):
        expected = "one dimension" if size is None else f"shape ({size},)"
        raise ValueError(f"{name} has shape {array.shape}, but it has to have {expected}.")
    bad = np.flatnonzero(~(np.isfinite(array) & (array >= least) & (array > above)))
    if bad.size:
        limit = f" and greater than {above:g}" if above > -math.inf else ""
        limit = f" and not less than {least:g}" if least > -math.inf else limit
        raise ValueError(f"{name}[{bad[0]}] is {array[bad[0]]:g}, but it has to be finite{limit}.")
    return array


def link_ends(name: str, value: Any, points: int) -> NDArray[np.intp]:
    """``value`` as an array (L, 2) of point numbers, -1 a ground; ValueError where it is not."""
    array = np.array(value)
    if array.size == 0:
        return np.zeros((0, 2), dtype=np.intp)
    if array.ndim != 2 or array.shape[1] != 2 or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} has to be an integer array of shape (links, 2), two points for each link.")
    outside = array[(array < -1) | (array >= points)]
    if outside.size:
        raise ValueError(f"{name} names point {outside[0]}, but there are only -1 (a ground) to {points - 1}.")
    return array.astype(np.intp)
