"""The string: equal masses in a row, moved in one pass over contiguous memory, many at once (`structure.py`).

Each mass is the one of `points.py`, each link the one of `linear_links.py`. With the sum of neighbours
s[i] = x[i-1] + x[i+1], a = T²/m K, b = T²/m B/T, e = T²/m (friction)/T, their recurrences together are

    x[n+1] = (2 - 2 (a + b) - e) x[n] + (a + b) s[n] - (1 - 2 b - e) x[n-1] - b s[n-1]

A stiff string also resists bending: with g = T²/m Kb, a force pulls each mass to the middle of its neighbours and these
the other way. Its energy is Kb/2 times the sum of the squares of the curvatures c[i] = x[i-1] - 2 x[i] + x[i+1], so
that the masses move in each sample by a further

    -g (c[i-1] - 2 c[i] + c[i+1]) = -g (x[i-2] - 4 x[i-1] + 6 x[i] - 4 x[i+1] + x[i+2])

A string stands in memory between two borders at each end. Where an end is free, the border goes where its mass is, so
that the link to it is never stretched; elsewhere both stay. The borders of a stiff string are put where the curvatures
that do no work come out as 0:

    fixed     the first stays where it is, the second mirrors the end's mass: c = 0 about the first, a hinge
    clamped   both stay where they are
    free      both go on in the line of the end's two masses: c = 0 about the end's mass and beyond. The link to the
              first, which is not there, has pulled then: that is taken back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.modules.structure import (
    LoadedPoints,
    StencilKernel,
    coefficient_terms,
    loaded_points_of,
    neighbours,
    neighbours_before,
    place_terms,
    push_loaded_points,
    stencil_kernel,
    sweep,
)
from hapsim.cordis.simd import fetch, padded, put_one, shift_lanes
from hapsim.scene import String

_ONE = np.uint64(1)
_STAYS, _FOLLOWS, _MIRRORS, _CONTINUES = (np.uint8(i) for i in range(4))  # what the borders at an end do
_BORDERS = {"fixed": _STAYS, "clamped": _STAYS, "free": _FOLLOWS}
_STIFF_BORDERS = {"fixed": _MIRRORS, "clamped": _STAYS, "free": _CONTINUES}


class StringRows(NamedTuple):
    """S strings: where their first mass is, how many each has, what the borders at each end do (S, 2)."""

    first: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    borders: NDArray[np.uint8]


class Strings(NamedTuple):
    """S strings: T²/m in m/N; K, B/T, friction/T and bending in N/m; shape (S,)."""

    rows: StringRows
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
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
    """Where these strings stand."""
    return StringRows(
        np.array([context.number[f"{name}.0"] for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array(
            [[(_STIFF_BORDERS if one.bending else _BORDERS)[end] for end in one.ends] for one in strings.values()],
            np.uint8,
        ),
    )


def _layout(string: String) -> tuple[Sequence[int], int]:
    """Two borders, the masses, two borders."""
    return range(2, string.masses + 2), padded(string.masses + 4)


def _strings(name: str, stencil: str, where: Callable[[Any], bool], integrate: NativeFunction) -> PartType:
    def build(strings: Mapping[str, String], columns: Sequence[Column], context: BuildContext) -> Part:
        ones = strings.values()
        stiffness, damping, friction = columns
        numbers = Strings(
            rows_of(strings, context),
            context.mobility([one.mass for one in ones]),
            stiffness,
            damping,
            friction,
            context.column([one.bending for one in ones]),
            loaded_points_of(strings, context),
        )
        return Part(numbers, initialize=initialize, integrate=integrate)

    compiled_as = f"a {stencil} over contiguous memory, many masses at once; links ask only those that they hold"
    return PartType(all_of(String, where), build, layout=_layout, name=name, compiled_as=compiled_as, moves_points=True)


@action
def initialize(strings, state):
    """The borders go where the masses were."""
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
        step = StringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
        )
        sweep(step, state, rows.first[s], rows.masses[s])
    push_loaded_points(strings.loaded, state)


@action
def integrate_stiff(strings, state):
    """Moves every stiff string by one sample."""
    strings, state = value_of(strings), value_of(state)
    rows = strings.rows
    for s in range(np.uint64(rows.first.size)):
        place_borders(rows, s, state.position)
        step = StiffStringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
            strings.mobility[s] * strings.bending[s],
        )
        first, end = rows.first[s], rows.first[s] + rows.masses[s]
        sweep(step, state, first, rows.masses[s])
        if rows.borders[s, 0] == _CONTINUES:
            _take_back(step, state, first, first - _ONE)
        if rows.borders[s, 1] == _CONTINUES:
            _take_back(step, state, end - _ONE, end)
    push_loaded_points(strings.loaded, state)


@inlined
def place_borders(rows, s, position):
    """Both ends' borders go where they belong to these positions."""
    first = rows.first[s]
    last = first + rows.masses[s] - _ONE
    _place(rows.borders[s, 0], position, first + _ONE, first, first - _ONE, first - np.uint64(2))
    _place(rows.borders[s, 1], position, last - _ONE, last, last + _ONE, last + np.uint64(2))


@inlined
def _place(borders, position, inner, outer, border, beyond):
    """The end's mass is at `outer`, its neighbour at `inner`."""
    if borders == _FOLLOWS:
        put_one(position, border, position[outer])
    elif borders == _CONTINUES:
        way = position[outer] - position[inner]
        put_one(position, border, position[outer] + way)
        put_one(position, beyond, position[outer] + way + way)
    elif borders == _MIRRORS:
        put_one(position, beyond, position[border] + (position[border] - position[outer]))


@inlined
def _take_back(step, state, mass, border):
    """Takes back what the link to a free end's border did."""
    x, before, after = state.position, state.previous, state.following
    d, d_before = x[border] - x[mass], before[border] - before[mass]
    put_one(after, mass, after[mass] - (step.a * d + step.b * (d - d_before)))


@fma
def _update_by_coefficients(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e, real(1) - real(2) * b - e
    return (now * x - old * before) + neighbours(terms)


@fma
def _update_by_differences(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    two = rows[0].dtype.type(2)
    way = x - before
    pull = neighbours(terms) - two * x
    pull_before = neighbours_before(terms) - two * before
    return x + (((way - e * way) + (a + b) * pull) - b * pull_before)


@fma
def _stiff_coefficient_terms(step, x, before):
    """What is asked of a neighbour, and of the one behind it."""
    a, b, _, g = step
    return (a + b + (g + g + g + g)) * x - b * before, x


@fma
def _update_stiff_by_coefficients(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e - real(6) * g, real(1) - real(2) * b - e
    pull = neighbours(terms) - g * (shift_lanes(terms, 1, -2) + shift_lanes(terms, 1, 2))
    return (now * x - old * before) + pull


@fma
def _update_stiff_by_differences(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    way = x - before
    pull = neighbours(terms) - real(2) * x
    pull_before = neighbours_before(terms) - real(2) * before
    bend = ((shift_lanes(terms, 0, -2) + shift_lanes(terms, 0, 2)) - real(2) * x) - real(4) * pull
    return x + ((((way - e * way) + (a + b) * pull) - b * pull_before) - g * bend)


stencil_kernel(
    StringStep,
    StencilKernel(coefficient_terms, _update_by_coefficients),
    StencilKernel(place_terms, _update_by_differences),
)
stencil_kernel(
    StiffStringStep,
    StencilKernel(_stiff_coefficient_terms, _update_stiff_by_coefficients),
    StencilKernel(place_terms, _update_stiff_by_differences),
)

STRING = _strings("strings", "stencil", lambda string: not string.bending, integrate)
STIFF_STRING = _strings("stiff strings", "stencil of five", lambda string: bool(string.bending), integrate_stiff)
