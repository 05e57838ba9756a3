"""Stencils: every mass of a structure moved alike, in one pass over contiguous memory.

What moves one mass is a step: a named tuple of the structure's numbers, with two functions (step, x, before, after,
here) registered for its type by `steps`. Both work out the same recurrence; which one is compiled, the kind of number
says. With 64 bits, each position is multiplied by a coefficient of its own: the fewest operations. With 32 bits these
coefficients, rounded, no longer cancel: a string of 100 masses would swing in its lowest mode by up to a thousandth too
fast or too slow. There differences of positions are taken first and multiplied afterwards, which leaves 1e-5 at most.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import types

from hapsim.compiled import inlined, overload

Cell = Callable[..., None]

LANES = np.uint64(16)  # masses that the compiler moves at once

_STEPS: dict[type, tuple[Cell, Cell]] = {}


def steps(step: type, by_coefficients: Cell, by_differences: Cell) -> None:
    """Registers what moves one mass by a sample: for 64 bits, and for 32."""
    _STEPS[step] = by_coefficients, by_differences


def move_one(step, x, before, after, here):
    """Moves the mass at `here` by one sample."""
    _STEPS[type(step)][x.dtype == np.float32](step, x, before, after, here)


@overload(move_one)
def _chosen(step, x, before, after, here):  # noqa: ARG001  (numba matches the names)
    chosen: Any = _STEPS[step.instance_class][x.dtype == types.float32]

    def move(step, x, before, after, here):
        chosen(step, x, before, after, here)

    return move


@inlined
def sweep(step, x, before, after, first, count):
    """Moves `count` masses from the one at `first` on.

    The loop is left to the compiler to do many masses at once. What does not fill its last round is done by going over
    some masses a second time, which changes nothing: a sample is never worked out from itself.
    """
    if count < LANES:
        for i in range(count):
            move_one(step, x, before, after, first + i)
        return
    for i in range(count & ~(LANES - np.uint64(1))):
        move_one(step, x, before, after, first + i)
    rest, end = count & (LANES - np.uint64(1)), first + count
    if rest > np.uint64(8):
        for i in range(np.uint64(16)):
            move_one(step, x, before, after, end - np.uint64(16) + i)
    elif rest > np.uint64(4):
        for i in range(np.uint64(8)):
            move_one(step, x, before, after, end - np.uint64(8) + i)
    elif rest > np.uint64(0):
        for i in range(np.uint64(4)):
            move_one(step, x, before, after, end - np.uint64(4) + i)
