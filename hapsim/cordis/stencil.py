"""Stencils: every mass of a structure moved alike, in one pass over contiguous memory, in lanes.

What moves the masses is a step: a named tuple of the structure's numbers, with two functions registered for its type
by `steps`. `tell` works out from x[n] and x[n-1] of some masses what their neighbours need of them, `follow` from that
and from what the neighbours told where they are at x[n+1]. So what is told is worked out once and not by each
neighbour anew.

Both stand there twice, for the same recurrence; which one is compiled, the kind of number says. With 64 bits, each
position is multiplied by a coefficient of its own: the fewest operations. With 32 bits these coefficients, rounded, no
longer cancel: a string of 100 masses would swing in its lowest mode by up to a thousandth too fast or too slow. There
differences of positions are taken first and multiplied afterwards, which leaves 1e-5 at most.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types

from hapsim.compiled import inlined, overload
from hapsim.cordis.lanes import chosen, fetch, put, width_of


class Way(NamedTuple):
    """How a step goes.

    `tell`: (step, x, before) -> a tuple of lanes, of masses that are at x now and were at `before` a sample ago.
    `follow`: (step, rows, here, told) -> the lanes at `here`, a sample on. `rows`: (x, before), `told`: what was told
    by the lanes to the left, by those here and by those to the right.
    """

    tell: Callable[..., Any]
    follow: Callable[..., Any]


_WAYS: dict[type, tuple[Way, Way]] = {}


def steps(step: type, by_coefficients: Way, by_differences: Way) -> None:
    """Registers what moves a structure's masses by a sample: for 64 bits, and for 32."""
    _WAYS[step] = by_coefficients, by_differences


def _tell(step, x, before):
    """Chosen by `_telling`."""


def _follow(step, rows, here, told):
    """Chosen by `_following`."""


@overload(_tell)
def _telling(step, x, before):  # noqa: ARG001  (numba matches the names)
    chosen_tell: Any = _WAYS[step.instance_class][x.dtype == types.float32].tell

    def tell(step, x, before):
        return chosen_tell(step, x, before)

    return tell


@overload(_follow)
def _following(step, rows, here, told):  # noqa: ARG001  (numba matches the names)
    chosen_follow: Any = _WAYS[step.instance_class][rows[0].dtype == types.float32].follow

    def follow(step, rows, here, told):
        return chosen_follow(step, rows, here, told)

    return follow


@inlined
def sweep(step, x, before, after, first, count):
    """Moves `count` masses from the one at `first` on, in rows of positions at three samples.

    There is a border or two before them, in the first one's lanes, and two numbers behind them. What stands beside
    them in the same lanes keeps its place: `after` has it where `x` does.
    """
    rows, width, end = (x, before), width_of(x), first + count
    here, last = first & ~(width - np.uint64(1)), (end - np.uint64(1)) & ~(width - np.uint64(1))
    beyond = (end + np.uint64(1)) & ~(width - np.uint64(1))  # where the second border is
    left = middle = _told_at(step, rows, here)  # the first border, or two, stand before the first mass in its lanes
    right = _told_at(step, rows, min(here + width, beyond))
    _put_inside(x, after, here, first, end, _follow(step, rows, here, (left, middle, right)))
    here += width
    while here < last:
        left, middle = middle, right
        right = _told_at(step, rows, here + width)
        put(after, here, _follow(step, rows, here, (left, middle, right)))
        here += width
    if here == last:
        left, middle, right = middle, right, _told_at(step, rows, beyond)
        _put_inside(x, after, here, first, end, _follow(step, rows, here, (left, middle, right)))


@inlined
def _told_at(step, rows, here):
    return _tell(step, fetch(rows[0], here), fetch(rows[1], here))


@inlined
def _put_inside(x, after, here, first, end, lanes):
    """What is not a mass stays."""
    put(after, here, chosen(lanes, fetch(x, here), np.int64(first - here), np.int64(end - here)))
