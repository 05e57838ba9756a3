"""What strings and membranes share: a stencil that moves every mass alike, in one pass over contiguous memory, in lanes
(`simd.py`), and the masses that links hold.

What moves the masses is a step: a named tuple of the structure's numbers, with a kernel registered for its type by
`stencil_kernel`. `neighbour_terms` works out from x[n] and x[n-1] of some masses what their neighbours need of them,
`update` from that and from the neighbours' terms where they are at x[n+1]. So each term is worked out once and not by
each neighbour anew.

A kernel has both twice, for the same recurrence; the precision decides which one is compiled. With 64 bits, each
position is multiplied by a coefficient of its own: the fewest operations. With 32 bits these coefficients, rounded, no
longer cancel: a string of 100 masses would swing in its lowest mode by up to a thousandth too fast or too slow. There
differences of positions are taken first and multiplied afterwards, which leaves 1e-5 at most.

A structure moves all its masses in one pass, without forces. Forces of links reach only the masses that they hold
(`LoadedPoints`): those are moved once more, and no other mass is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined, overload
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Column
from hapsim.cordis.simd import add_to_one, chosen, fetch, put, shift_lanes, width_of


class LoadedPoints(NamedTuple):
    """The masses of a type of structure that links hold, by number, and their T²/m in m/N; shape (P,)."""

    point: NDArray[np.uint32]
    mobility: Column


def loaded_points_of(structures: Mapping[str, Any], context: BuildContext) -> LoadedPoints:
    """Those masses of these structures that a link holds."""
    numbers = [
        (context.number[f"{name}.{place}"], one.mass) for name, one in structures.items() for place in one.point_names()
    ]
    loaded = [(number, mass) for number, mass in numbers if number in context.loaded]
    point = np.array([number for number, _ in loaded], np.uint32)
    return LoadedPoints(point, context.mobility([mass for _, mass in loaded]))


@inlined
def push_loaded_points(loaded, state):
    """Adds to the motion of each mass that links hold what their force on it does, and uses up the force."""
    for i in range(np.uint64(loaded.point.size)):
        p = loaded.point[i]
        add_to_one(state.following, np.uint64(p), loaded.mobility[i] * state.force[p])
        state.force[p] = 0.0


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


@fma
def coefficient_terms(step, x, before):
    """What is s[n] and s[n-1] to a neighbour, of a string or a membrane."""
    return ((step.a + step.b) * x - step.b * before,)


@inlined
def place_terms(step, x, before):  # noqa: ARG001  (every step's)
    """Where masses are and were, for steps that work out differences."""
    return x, before


@inlined
def neighbours(terms):
    """The sum of the first terms of both neighbours in a row."""
    return shift_lanes(terms, 0, -1) + shift_lanes(terms, 0, 1)


@inlined
def neighbours_before(terms):
    """The sum of their second terms: by `place_terms`, of a sample before."""
    return shift_lanes(terms, 1, -1) + shift_lanes(terms, 1, 1)


@inlined
def sweep(step, state, first, count):
    """Moves `count` masses from the one at `first` on by a sample.

    There is a border or two before them, in the first one's lanes, and two numbers behind them. What stands beside
    them in the same lanes keeps its place: `following` has it where `position` does.
    """
    x, after = state.position, state.following
    rows, width, end = (x, state.previous), width_of(x), first + count
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
