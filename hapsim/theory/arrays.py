"""Array types of the theory, the order in which poles are listed, and validation of arguments."""

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
    """Sorts along the last axis by decreasing modulus; conjugates stay together, the one above the real axis first."""
    order = np.lexsort((-values.imag, -values.real, -np.abs(values)), axis=-1)
    return np.take_along_axis(values, order, axis=-1)


def positive(name: str, value: Any) -> float:
    """Returns ``value`` as a float; raises ValueError unless it is one finite number greater than zero."""
    number = _finite(name, value)
    if number <= 0.0:
        raise ValueError(f"{name} is {number:g}, but it has to be greater than zero.")
    return number


def not_negative(name: str, value: Any) -> float:
    """Returns ``value`` as a float; raises ValueError unless it is one finite number, zero or greater."""
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
    """Returns ``value``; raises ValueError, with the list of known names, if it is none of them."""
    if not isinstance(value, str) or value not in known:
        raise ValueError(f"{name} is {value!r}, but it has to be one of: {', '.join(known)}.")
    return value


def vector(
    name: str, value: Any, size: int | None = None, *, least: float = -math.inf, above: float = -math.inf
) -> Floats:
    """Returns ``value`` as an array (size,); raises ValueError if it is not one, or an element is out of range."""
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


def matrix(name: str, value: Any, columns: int) -> Floats:
    """Returns ``value`` as an array (n, columns); raises ValueError if it is not one of finite numbers."""
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{name} has to be an array of numbers.") from None
    array = array.reshape(-1, columns) if array.size == 0 else array
    if array.ndim != 2 or array.shape[1] != columns or not np.isfinite(array).all():
        raise ValueError(f"{name} has to be a matrix of finite numbers with {columns} columns.")
    return array


def link_ends(name: str, value: Any, points: int) -> NDArray[np.intp]:
    """Returns ``value`` as an array (L, 2) of point numbers, -1 for a ground; raises ValueError if it is not one."""
    array = np.array(value)
    if array.size == 0:
        return np.zeros((0, 2), dtype=np.intp)
    if array.ndim != 2 or array.shape[1] != 2 or not np.issubdtype(array.dtype, np.integer):
        raise ValueError(f"{name} has to be an integer array of shape (links, 2), two points for each link.")
    outside = array[(array < -1) | (array >= points)]
    if outside.size:
        raise ValueError(f"{name} names point {outside[0]}, but there are only -1 (a ground) to {points - 1}.")
    return array.astype(np.intp)


def powered(change: Floats, count: int) -> Floats:
    """Returns (1 + change)^count - 1, computed from the highest bit down."""
    out = change if count else 0.0 * change
    for bit in bin(count)[3:]:
        out = 2.0 * out + out @ out
        if bit == "1":
            out = out + change + change @ out
    return out
