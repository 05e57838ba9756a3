"""The string: equal masses in a row, moved in one pass over contiguous memory, many at once (`structure.py`).

Each mass is the one of `points.py`, each link the one of `linear_links.py`. With the sum of neighbours
s[i] = x[i-1] + x[i+1], a = T²/m K, b = T²/m B/T, e = T²/m (friction)/T, their recurrences together are

    x[n+1] = (2 - 2 (a + b) - e) x[n] + (a + b) s[n] - (1 - 2 b - e) x[n-1] - b s[n-1]

A stiff string also resists bending: with g = T²/m Kb, a force pulls each mass to the middle of its neighbours and these
the other way. Its energy is Kb/2 times the sum of the squares of the curvatures c[i] = x[i-1] - 2 x[i] + x[i+1], so
that the masses move in each sample by a further

    -g (c[i-1] - 2 c[i] + c[i+1]) = -g (x[i-2] - 4 x[i-1] + 6 x[i] - 4 x[i+1] + x[i+2])

A string is in memory between two borders at each end. At a free end the border is at its mass, so that the link to it
is never stretched; at other ends both stay. The borders of a stiff string make the curvatures that do no work 0:

    fixed     the first stays at its place, the second mirrors the end's mass: c = 0 about the first, a hinge clamped
    both stay at their places free      both continue the line of the end's two masses: c = 0 about the end's mass and
    beyond. The pull of the link
              to the first, which does not exist, is subtracted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Column, action
from hapsim.cordis.modules.structure import (
    STENCIL_KERNELS,
    LoadedPoints,
    StencilKernel,
    UniformLinks,
    linear_terms,
    link_coefficients,
    neighbours,
    next_position,
    push_loaded_points,
    structure_type,
    sweep,
)
from hapsim.cordis.simd import padded, put_one, shift_lanes
from hapsim.scene import String

_ONE = np.uint64(1)
_FIXED, _EQUAL, _MIRRORED, _EXTRAPOLATED = (np.uint8(i) for i in range(4))  # motion of an end's borders
_BORDERS = {"fixed": _FIXED, "clamped": _FIXED, "free": _EQUAL}
_STIFF_BORDERS = {"fixed": _MIRRORED, "clamped": _FIXED, "free": _EXTRAPOLATED}


class StringRows(NamedTuple):
    """S strings: number of the first mass, count of masses, motion of the borders at each end (S, 2)."""

    first: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    borders: NDArray[np.uint8]


class Strings(NamedTuple):
    """S strings; `bending` in N/m, shape (S,)."""

    rows: StringRows
    links: UniformLinks
    bending: Column
    loaded: LoadedPoints


class StringStep(NamedTuple):
    """`a`, `b`, `e` as above."""

    a: float
    b: float
    e: float


class StiffStringStep(NamedTuple):
    """`a`, `b`, `e`, `g` as above."""

    a: float
    b: float
    e: float
    g: float


def rows_of(strings: Mapping[str, String], context: BuildContext) -> StringRows:
    """Returns the places of these strings in memory."""
    borders = [[(_STIFF_BORDERS if one.bending else _BORDERS)[end] for end in one.ends] for one in strings.values()]
    return StringRows(
        np.array([context.number[f"{name}.0"] for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array(borders, np.uint8),
    )


def _numbers(strings: Mapping[str, Any], links: UniformLinks, loaded: LoadedPoints, context: BuildContext) -> Strings:
    bending = context.column([one.bending for one in strings.values()])
    return Strings(rows_of(strings, context), links, bending, loaded)


def _layout(string: String) -> tuple[Sequence[int], int]:
    """Returns the layout: two borders, the masses, two borders."""
    return range(2, string.masses + 2), padded(string.masses + 4)


@action
def initialize(strings, state):
    """Places the borders for the earlier positions of the masses."""
    strings, state = value_of(strings), value_of(state)
    for s in range(np.uint64(strings.rows.first.size)):
        place_borders(strings.rows, s, state.previous)


@action
def integrate(strings, state):
    """Moves every string by one sample."""
    strings, state = value_of(strings), value_of(state)
    rows = strings.rows
    for s in range(np.uint64(rows.first.size)):
        place_borders(rows, s, state.position)
        a, b, e = link_coefficients(strings.links, s)
        sweep(StringStep(a, b, e), state, rows.first[s], rows.masses[s])
    push_loaded_points(strings.loaded, state)


@action
def integrate_stiff(strings, state):
    """Moves every stiff string by one sample."""
    strings, state = value_of(strings), value_of(state)
    rows = strings.rows
    for s in range(np.uint64(rows.first.size)):
        place_borders(rows, s, state.position)
        a, b, e = link_coefficients(strings.links, s)
        step = StiffStringStep(a, b, e, strings.links.mobility[s] * strings.bending[s])
        first, end = rows.first[s], rows.first[s] + rows.masses[s]
        pulls = _border_pull(step, state, first, first - _ONE), _border_pull(step, state, end - _ONE, end)
        sweep(step, state, first, rows.masses[s])
        if rows.borders[s, 0] == _EXTRAPOLATED:
            put_one(state.previous, first, state.previous[first] - pulls[0])
        if rows.borders[s, 1] == _EXTRAPOLATED:
            put_one(state.previous, end - _ONE, state.previous[end - _ONE] - pulls[1])
    push_loaded_points(strings.loaded, state)


@inlined
def place_borders(rows, s, position):
    """Places both ends' borders for these positions."""
    first = rows.first[s]
    last = first + rows.masses[s] - _ONE
    _place_end(rows.borders[s, 0], position, first + _ONE, first, first - _ONE, first - np.uint64(2))
    _place_end(rows.borders[s, 1], position, last - _ONE, last, last + _ONE, last + np.uint64(2))


@inlined
def _place_end(borders, position, inner, outer, border, beyond):
    """Places the borders of one end. `outer`: the end's mass; `inner`: its neighbour."""
    if borders == _EQUAL:
        put_one(position, border, position[outer])
    elif borders == _EXTRAPOLATED:
        way = position[outer] - position[inner]
        put_one(position, border, position[outer] + way)
        put_one(position, beyond, position[outer] + way + way)
    elif borders == _MIRRORED:
        put_one(position, beyond, position[border] + (position[border] - position[outer]))


@inlined
def _border_pull(step, state, mass, border):
    """Returns the motion of the end's mass by the link to its border, m; a free end subtracts it."""
    x, before = state.position, state.previous
    d, d_before = x[border] - x[mass], before[border] - before[mass]
    return step.a * d + step.b * (d - d_before)


@fma
def _update(step, rows, _here, terms):
    t, x, before = terms[1]
    return next_position(step, x, before, neighbours(terms, 0) - rows[0].dtype.type(2) * t)


@fma
def _stiff_terms(step, x, before):
    a, b, _, g = step
    return (a + b + (g + g + g + g)) * x - b * before, x, before


@fma
def _update_stiff(step, rows, _here, terms):
    t, x, before = terms[1]
    two = rows[0].dtype.type(2)
    bend = (shift_lanes(terms, 1, -2) + shift_lanes(terms, 1, 2)) - two * x
    return next_position(step, x, before, (neighbours(terms, 0) - two * t) - step.g * bend)


STENCIL_KERNELS[StringStep] = StencilKernel(linear_terms, _update)
STENCIL_KERNELS[StiffStringStep] = StencilKernel(_stiff_terms, _update_stiff)

_string_type = partial(structure_type, String, _numbers, _layout, initialize)
STRING = _string_type(integrate, "strings", "a stencil over contiguous memory", where=lambda string: not string.bending)
STIFF_STRING = _string_type(
    integrate_stiff, "stiff strings", "a stencil of five over contiguous memory", where=lambda string: string.bending
)
