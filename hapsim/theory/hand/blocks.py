"""Large arrays in blocks that fit a core's cache. (Threads were tried: between operations so short they only wait.)"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Floats

POINTS = 32768


def quietly_in_blocks(method: Callable[..., Any]) -> Callable[..., Any]:
    """For methods of two arrays (n,) that treat every pair of entries by itself: called with arrays of any shapes.

    They are broadcast against each other, and the results have their shape; scalars give scalars. What is out of range
    becomes NaN, and nothing warns.
    """

    def _quietly(self: Any, one: Floats, other: Floats, **named: Any) -> Any:
        with np.errstate(all="ignore"):
            return method(self, one, other, **named)

    takes = signature(method)
    first_three = list(takes.parameters)[:3]

    @wraps(method)
    def _whole(self: Any, *values: ArrayLike, **named: Any) -> Any:
        given = takes.bind(self, *values, **named).arguments
        _, *values_given = (given.pop(name) for name in first_three)
        one, other = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in values_given))
        named = given
        shape, one, other = one.shape, one.ravel(), other.ravel()
        if one.size <= 2 * POINTS:
            return _in_shape(_quietly(self, one, other, **named), shape)
        blocks = [slice(at, at + POINTS) for at in range(0, one.size, POINTS)]
        parts = [_quietly(self, one[block], other[block], **named) for block in blocks]
        if isinstance(parts[0], tuple):
            return _in_shape(tuple(np.concatenate(column) for column in zip(*parts, strict=True)), shape)
        return _in_shape(np.concatenate(parts), shape)

    return _whole


def _in_shape(result: Any, shape: tuple[int, ...]) -> Any:
    if isinstance(result, tuple):
        return tuple(_in_shape(column, shape) for column in result)
    return result.reshape(shape + result.shape[1:])[()]
