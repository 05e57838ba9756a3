"""The string: equal masses in a row, moved in one pass over contiguous memory, many at once (`stencil.py`).

Each mass is the one of `mass.py`, each link the one of `damper_backward.py`. With the sum of neighbours
s[i] = x[i-1] + x[i+1], a = T²/m K, b = T²/m B/T, e = T²/m (friction)/T, their recurrences together are

    x[n+1] = (2 - 2 (a + b) - e) x[n] + (a + b) s[n] - (1 - 2 b - e) x[n-1] - b s[n-1]

A string stands in memory between two borders. The border of an end that is held stays where it is; that of a free end
follows its neighbour, so that the link to it is never stretched. A string with a stiffness against bending is another
kind: `stiff_string.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, settles
from hapsim.cordis.held import Held, held_of, push_held
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.lanes import beside, fetch, padded, put_one
from hapsim.cordis.mass import mobility_of
from hapsim.cordis.stencil import Way, steps, sweep
from hapsim.scene import Scene, String


class Rows(NamedTuple):
    """S strings: where their left border is, how many masses each has, and which ends are free (S, 2)."""

    border: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    free: NDArray[np.bool_]


class Strings(NamedTuple):
    """S strings: T²/m in m/N; K, B/T and friction/T in N/m; shape (S,)."""

    rows: Rows
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    held: Held | None


class StringStep(NamedTuple):
    """`a`, `b`, `e` as above."""

    a: float
    b: float
    e: float


def _select(scene: Scene) -> Mapping[str, String]:
    return {name: one for name, one in scene.modules.items() if isinstance(one, String) and not one.bending}


def live_structures(structures: Sequence[Any], rate: float) -> list[list[float]]:
    """K, and what it and its friction do in a sample, in N/m, of strings or membranes."""
    return [
        [one.stiffness for one in structures],
        [one.damping * rate for one in structures],
        [one.friction * rate for one in structures],
    ]


def rows_of(strings: Mapping[str, String], frame: Frame) -> Rows:
    """Where these strings stand."""
    return Rows(
        np.array([frame.number[f"{name}.0"] - 1 for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array([[end == "free" for end in one.ends] for one in strings.values()]),
    )


def _build(strings: Mapping[str, String], columns: Sequence[Column], frame: Frame) -> Strings:
    mobility = mobility_of([one.mass for one in strings.values()], frame)
    stiffness, damping, friction = columns
    return Strings(rows_of(strings, frame), mobility, stiffness, damping, friction, held_of(strings, frame))


def _layout(string: String) -> tuple[Sequence[int], int]:
    """A border, the masses, a border, and what a sweep reads behind it."""
    return range(1, string.masses + 1), padded(string.masses + 3)


STRING = Kind(
    _select,
    _build,
    live_structures,
    _layout,
    name="strings",
    compiled_as="a stencil over contiguous memory, many masses at once; only those under links are asked for a force",
)


@settles(Strings)
@inlined
def settle_strings(strings, moment):
    """Before the first tick: a free end's border follows its neighbour."""
    for s in range(strings.rows.border.size):
        free_ends(strings.rows, s, moment.previous)


@moves(Strings)
@inlined
def advance_strings(strings, moment):
    """Moves every string by one sample."""
    rows = strings.rows
    for s in range(rows.border.size):
        free_ends(rows, s, moment.position)
        step = StringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
        )
        first = rows.border[s] + np.uint64(1)
        sweep(step, moment.position, moment.previous, moment.following, first, rows.masses[s])
    push_held(strings.held, moment)


@inlined
def free_ends(rows, s, position):
    """The border of a free end goes where its neighbour is."""
    left, right = rows.border[s], rows.border[s] + rows.masses[s] + np.uint64(1)
    if rows.free[s, 0]:
        put_one(position, left, position[left + np.uint64(1)])
    if rows.free[s, 1]:
        put_one(position, right, position[right - np.uint64(1)])


@fused
def tell_coefficients(step, x, before):
    """What is s[n] and s[n-1] to a neighbour, of a string or a membrane."""
    return ((step.a + step.b) * x - step.b * before,)


@fused
def _follow_coefficients(step, rows, here, told):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e, real(1) - real(2) * b - e
    return (now * x - old * before) + (beside(told, 0, -1) + beside(told, 0, 1))


@inlined
def tell_places(step, x, before):  # noqa: ARG001  (every step's)
    """Where masses are and were, for steps that work out differences."""
    return x, before


@fused
def _follow_differences(step, rows, here, told):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    two = rows[0].dtype.type(2)
    way = x - before
    pull = (beside(told, 0, -1) + beside(told, 0, 1)) - two * x
    pull_before = (beside(told, 1, -1) + beside(told, 1, 1)) - two * before
    return x + (((way - e * way) + (a + b) * pull) - b * pull_before)


steps(StringStep, Way(tell_coefficients, _follow_coefficients), Way(tell_places, _follow_differences))
