"""Stencils: every mass of a structure moved alike, in one pass over contiguous memory, in lanes.

What moves the masses is a step: a named tuple of the structure's numbers, with a kernel registered for its type by
`stencil_kernel`. `neighbour_terms` works out from x[n] and x[n-1] of some masses what their neighbours need of them,
`update` from that and from the neighbours' terms where they are at x[n+1]. So each term is worked out once and not by
each neighbour anew.

Both stand there twice, for the same recurrence; which one is compiled, the precision says. With 64 bits, each position
is multiplied by a coefficient of its own: the fewest operations. With 32 bits these coefficients, rounded, no longer
cancel: a string of 100 masses would swing in its lowest mode by up to a thousandth too fast or too slow. There
differences of positions are taken first and multiplied afterwards, which leaves 1e-5 at most.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numba import types

from hapsim.compiling import inlined, overload
from hapsim.cordis.simd.lanes import chosen, fetch, put, width_of


class StencilKernel(NamedTuple):
    """How a step goes.

    `neighbour_terms`: (step, x, before) -> a tuple of lanes, of masses that are at x now and were at `before` a sample
    ago. `update`: (step, rows, here, terms) -> the lanes at `here`, a sample on. `rows`: (x, before); `terms`: those of
    the lanes to the left, of those here and of those to the right.
    """

    neighbour_terms: Callable[..., Any]
    update: Callable[..., Any]


_KERNELS: dict[type, tuple[StencilKernel, StencilKernel]] = {}


def stencil_kernel(step: type, by_coefficients: StencilKernel, by_differences: StencilKernel) -> None:
    """Registers what moves a structure's masses by a sample: for 64 bits, and for 32."""
    _KERNELS[step] = by_coefficients, by_differences


def _neighbour_terms(step, x, before):
    """Chosen by `_choose_neighbour_terms`."""


def _update(step, rows, here, terms):
    """Chosen by `_choose_update`."""


@overload(_neighbour_terms)
def _choose_neighbour_terms(step, x, before):  # noqa: ARG001  (numba matches the names)
    kernel: Any = _KERNELS[step.instance_class][x.dtype == types.float32].neighbour_terms

    def neighbour_terms(step, x, before):
        return kernel(step, x, before)

    return neighbour_terms


@overload(_update)
def _choose_update(step, rows, here, terms):  # noqa: ARG001  (numba matches the names)
    kernel: Any = _KERNELS[step.instance_class][rows[0].dtype == types.float32].update

    def update(step, rows, here, terms):
        return kernel(step, rows, here, terms)

    return update


@inlined
def sweep(step, x, before, after, first, count):
    """Moves `count` masses from the one at `first` on, in rows of positions at three samples.

    There is a border or two before them, in the first one's lanes, and two numbers behind them. What stands beside
    them in the same lanes keeps its place: `after` has it where `x` does.
    """
    rows, width, end = (x, before), width_of(x), first + count
    here, last = first & ~(width - np.uint64(1)), (end - np.uint64(1)) & ~(width - np.uint64(1))
    beyond = (end + np.uint64(1)) & ~(width - np.uint64(1))  # where the second border is
    left = middle = _terms_at(step, rows, here)  # the first border, or two, stand before the first mass in its lanes
    right = _terms_at(step, rows, min(here + width, beyond))
    _put_inside(x, after, here, first, end, _update(step, rows, here, (left, middle, right)))
    here += width
    while here < last:
        left, middle = middle, right
        right = _terms_at(step, rows, here + width)
        put(after, here, _update(step, rows, here, (left, middle, right)))
        here += width
    if here == last:
        left, middle, right = middle, right, _terms_at(step, rows, beyond)
        _put_inside(x, after, here, first, end, _update(step, rows, here, (left, middle, right)))


@inlined
def _terms_at(step, rows, here):
    return _neighbour_terms(step, fetch(rows[0], here), fetch(rows[1], here))


@inlined
def _put_inside(x, after, here, first, end, lanes):
    """What is not a mass stays."""
    put(after, here, chosen(lanes, fetch(x, here), np.int64(first - here), np.int64(end - here)))
