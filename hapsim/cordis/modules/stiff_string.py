"""The stiff string: a string that also resists bending.

The recurrence is that of `string.py`, with g = T²/m Kb and one more force, which pulls each mass to the middle of its
neighbours and these the other way: the energy is Kb/2 times the sum of the squares of the curvatures
c[i] = x[i-1] - 2 x[i] + x[i+1], so that the masses move in each sample by a further

    -g (c[i-1] - 2 c[i] + c[i+1]) = -g (x[i-2] - 4 x[i-1] + 6 x[i] - 4 x[i+1] + x[i+2])

A stiff string stands in memory between two borders at each end. They are put where the curvatures that do no work come
out as 0:

    fixed     the first stays where it is, the second mirrors the end's mass: c = 0 about the first, a hinge
    clamped   both stay where they are
    free      both go on in the line of the end's two masses: c = 0 about the end's mass and beyond. The link to the
              first, which is not there, has pulled then: that is taken back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.modules.loaded_points import LoadedPoints, loaded_points_of, push_loaded_points
from hapsim.cordis.modules.mass import mobility_of
from hapsim.cordis.modules.string import live_structures, place_terms
from hapsim.cordis.simd.lanes import fetch, padded, put_one, shift_lanes
from hapsim.cordis.simd.stencil import StencilKernel, stencil_kernel, sweep
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene, String

_FIXED, _CLAMPED, _FREE = np.uint8(0), np.uint8(1), np.uint8(2)
_ENDS = {"fixed": _FIXED, "clamped": _CLAMPED, "free": _FREE}


class StiffStrings(NamedTuple):
    """S stiff strings: where their first mass is, how many each has, of which kind each end is (S, 2); T²/m in m/N;
    K, B/T, friction/T and bending in N/m; shape (S,)."""

    first: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    ends: NDArray[np.uint8]
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    bending: Column
    loaded: LoadedPoints


class StiffStringStep(NamedTuple):
    """`a`, `b`, `e`, `g` as above."""

    a: float
    b: float
    e: float
    g: float


def _select(scene: Scene) -> Mapping[str, String]:
    return {name: one for name, one in scene.modules.items() if isinstance(one, String) and one.bending}


def _build(strings: Mapping[str, String], columns: Sequence[Column], context: BuildContext) -> Part:
    stiffness, damping_per_sample, friction_per_sample = columns
    numbers = StiffStrings(
        np.array([context.number[f"{name}.0"] for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array([[_ENDS[end] for end in one.ends] for one in strings.values()], np.uint8),
        mobility_of([one.mass for one in strings.values()], context),
        stiffness,
        damping_per_sample,
        friction_per_sample,
        context.column([one.bending for one in strings.values()]),
        loaded_points_of(strings, context),
    )
    return Part(numbers, initialize=initialize, integrate=integrate)


def _layout(string: String) -> tuple[Sequence[int], int]:
    """Two borders, the masses, two borders."""
    return range(2, string.masses + 2), padded(string.masses + 4)


STIFF_STRING = PartType(
    _select,
    _build,
    live_structures,
    _layout,
    name="stiff strings",
    compiled_as="a stencil of five over contiguous memory, many masses at once",
    moves_points=True,
)


@action
def initialize(strings, state):
    """The borders go where the masses were."""
    strings, state = value_of(strings), value_of(state)
    for s in range(np.uint64(strings.first.size)):
        _place_borders(strings, s, state.previous)


@action
def integrate(strings, state):
    """Moves every stiff string by one sample."""
    strings, state = value_of(strings), value_of(state)
    for s in range(np.uint64(strings.first.size)):
        _place_borders(strings, s, state.position)
        step = StiffStringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
            strings.mobility[s] * strings.bending[s],
        )
        x, before, after = state.position, state.previous, state.following
        first, end = strings.first[s], strings.first[s] + strings.masses[s]
        sweep(step, x, before, after, first, strings.masses[s])
        if strings.ends[s, 0] == _FREE:
            _take_back(step, x, before, after, first, first - np.uint64(1))
        if strings.ends[s, 1] == _FREE:
            _take_back(step, x, before, after, end - np.uint64(1), end)
    push_loaded_points(strings.loaded, state)


@inlined
def _place_borders(strings, s, position):
    """Both ends' borders go where they belong to these positions."""
    first = strings.first[s]
    last = first + strings.masses[s] - np.uint64(1)
    _place(strings.ends[s, 0], position, first + np.uint64(1), first, first - np.uint64(1), first - np.uint64(2))
    _place(strings.ends[s, 1], position, last - np.uint64(1), last, last + np.uint64(1), last + np.uint64(2))


@inlined
def _place(end, position, inner, outer, border, beyond):
    """The end's mass is at `outer`, its neighbour at `inner`."""
    if end == _FREE:
        way = position[outer] - position[inner]
        put_one(position, border, position[outer] + way)
        put_one(position, beyond, position[outer] + way + way)
    elif end == _FIXED:
        put_one(position, beyond, position[border] + (position[border] - position[outer]))


@inlined
def _take_back(step, x, before, after, mass, border):
    """Takes back what the link to a free end's border did."""
    d, d_before = x[border] - x[mass], before[border] - before[mass]
    put_one(after, mass, after[mass] - (step.a * d + step.b * (d - d_before)))


@fma
def _coefficient_terms(step, x, before):
    """What is asked of a neighbour, and of the one behind it."""
    a, b, _, g = step
    return (a + b + (g + g + g + g)) * x - b * before, x


@fma
def _update_by_coefficients(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e - real(6) * g, real(1) - real(2) * b - e
    pull = (shift_lanes(terms, 0, -1) + shift_lanes(terms, 0, 1)) - g * (
        shift_lanes(terms, 1, -2) + shift_lanes(terms, 1, 2)
    )
    return (now * x - old * before) + pull


@fma
def _update_by_differences(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    way = x - before
    pull = (shift_lanes(terms, 0, -1) + shift_lanes(terms, 0, 1)) - real(2) * x
    pull_before = (shift_lanes(terms, 1, -1) + shift_lanes(terms, 1, 1)) - real(2) * before
    bend = ((shift_lanes(terms, 0, -2) + shift_lanes(terms, 0, 2)) - real(2) * x) - real(4) * pull
    return x + ((((way - e * way) + (a + b) * pull) - b * pull_before) - g * bend)


stencil_kernel(
    StiffStringStep,
    StencilKernel(_coefficient_terms, _update_by_coefficients),
    StencilKernel(place_terms, _update_by_differences),
)
