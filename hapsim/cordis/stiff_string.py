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

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, settles
from hapsim.cordis.held import Held, held_of, push_held
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.lanes import beside, fetch, padded, put_one
from hapsim.cordis.mass import mobility_of
from hapsim.cordis.stencil import Way, steps, sweep
from hapsim.cordis.string import live_structures, tell_places
from hapsim.scene import Scene, String

_FIXED, _CLAMPED, _FREE = np.uint8(0), np.uint8(1), np.uint8(2)
_ENDS = {"fixed": _FIXED, "clamped": _CLAMPED, "free": _FREE}


class StiffStrings(NamedTuple):
    """S stiff strings: where their first mass is, how many each has, how each end is held (S, 2); T²/m in m/N; K, B/T,
    friction/T and bending in N/m; shape (S,)."""

    first: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    ends: NDArray[np.uint8]
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    bending: Column
    held: Held | None


class StiffStringStep(NamedTuple):
    """`a`, `b`, `e`, `g` as above."""

    a: float
    b: float
    e: float
    g: float


def _select(scene: Scene) -> Mapping[str, String]:
    return {name: one for name, one in scene.modules.items() if isinstance(one, String) and one.bending}


def _build(strings: Mapping[str, String], columns: Sequence[Column], frame: Frame) -> StiffStrings:
    stiffness, damping, friction = columns
    return StiffStrings(
        np.array([frame.number[f"{name}.0"] for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array([[_ENDS[end] for end in one.ends] for one in strings.values()], np.uint8),
        mobility_of([one.mass for one in strings.values()], frame),
        stiffness,
        damping,
        friction,
        frame.column([one.bending for one in strings.values()]),
        held_of(strings, frame),
    )


def _layout(string: String) -> tuple[Sequence[int], int]:
    """Two borders, the masses, two borders."""
    return range(2, string.masses + 2), padded(string.masses + 4)


STIFF_STRING = Kind(
    _select,
    _build,
    live_structures,
    _layout,
    name="stiff strings",
    compiled_as="a stencil of five over contiguous memory, many masses at once",
)


@settles(StiffStrings)
@inlined
def settle_stiff_strings(strings, moment):
    """Before the first tick: the borders go where the masses were."""
    for s in range(strings.first.size):
        _place_borders(strings, s, moment.previous)


@moves(StiffStrings)
@inlined
def advance_stiff_strings(strings, moment):
    """Moves every stiff string by one sample."""
    for s in range(strings.first.size):
        _place_borders(strings, s, moment.position)
        step = StiffStringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
            strings.mobility[s] * strings.bending[s],
        )
        x, before, after = moment.position, moment.previous, moment.following
        first, end = strings.first[s], strings.first[s] + strings.masses[s]
        sweep(step, x, before, after, first, strings.masses[s])
        if strings.ends[s, 0] == _FREE:
            _let_go(step, x, before, after, first, first - np.uint64(1))
        if strings.ends[s, 1] == _FREE:
            _let_go(step, x, before, after, end - np.uint64(1), end)
    push_held(strings.held, moment)


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
def _let_go(step, x, before, after, mass, border):
    """Takes back what the link to a free end's border did."""
    d, d_before = x[border] - x[mass], before[border] - before[mass]
    put_one(after, mass, after[mass] - (step.a * d + step.b * (d - d_before)))


@fused
def _tell_coefficients(step, x, before):
    """What is asked of a neighbour, and of the one behind it."""
    a, b, _, g = step
    return (a + b + (g + g + g + g)) * x - b * before, x


@fused
def _follow_coefficients(step, rows, here, told):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e - real(6) * g, real(1) - real(2) * b - e
    pull = (beside(told, 0, -1) + beside(told, 0, 1)) - g * (beside(told, 1, -2) + beside(told, 1, 2))
    return (now * x - old * before) + pull


@fused
def _follow_differences(step, rows, here, told):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e, g = step
    real = rows[0].dtype.type
    way = x - before
    pull = (beside(told, 0, -1) + beside(told, 0, 1)) - real(2) * x
    pull_before = (beside(told, 1, -1) + beside(told, 1, 1)) - real(2) * before
    bend = ((beside(told, 0, -2) + beside(told, 0, 2)) - real(2) * x) - real(4) * pull
    return x + ((((way - e * way) + (a + b) * pull) - b * pull_before) - g * bend)


steps(StiffStringStep, Way(_tell_coefficients, _follow_coefficients), Way(tell_places, _follow_differences))
