"""The string: equal masses in a row, moved in one pass over contiguous memory, many at once (`stencil.py`).

Each mass is the one of `mass.py`, each link the one of `damper_backward.py`. With the sum of neighbours
s[i] = x[i-1] + x[i+1], a = T²/m K, b = T²/m B/T, e = T²/m (friction)/T, their recurrences together are

    x[n+1] = (2 - 2 (a + b) - e) x[n] + (a + b) s[n] - (1 - 2 b - e) x[n-1] - b s[n-1]

A string stands in memory between two borders. The border of a fixed end stays where it is; that of a free end
follows its neighbour, so that the link to it is never stretched. A string with a stiffness against bending is another
kind: `stiff_string.py`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.modules.loaded_points import LoadedPoints, loaded_points_of, push_loaded_points
from hapsim.cordis.modules.mass import mobility_of
from hapsim.cordis.simd.lanes import fetch, padded, put_one, shift_lanes
from hapsim.cordis.simd.stencil import StencilKernel, stencil_kernel, sweep
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene, String


class StringRows(NamedTuple):
    """S strings: where their left border is, how many masses each has, and which ends are free (S, 2)."""

    border: NDArray[np.uint64]
    masses: NDArray[np.uint64]
    free: NDArray[np.bool_]


class Strings(NamedTuple):
    """S strings: T²/m in m/N; K, B/T and friction/T in N/m; shape (S,)."""

    rows: StringRows
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    loaded: LoadedPoints


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


def rows_of(strings: Mapping[str, String], context: BuildContext) -> StringRows:
    """Where these strings stand."""
    return StringRows(
        np.array([context.number[f"{name}.0"] - 1 for name in strings], np.uint64),
        np.array([one.masses for one in strings.values()], np.uint64),
        np.array([[end == "free" for end in one.ends] for one in strings.values()]),
    )


def _build(strings: Mapping[str, String], columns: Sequence[Column], context: BuildContext) -> Part:
    mobility = mobility_of([one.mass for one in strings.values()], context)
    loaded = loaded_points_of(strings, context)
    stiffness, damping_per_sample, friction_per_sample = columns
    numbers = Strings(rows_of(strings, context), mobility, stiffness, damping_per_sample, friction_per_sample, loaded)
    return Part(numbers, initialize=initialize, integrate=integrate)


def _layout(string: String) -> tuple[Sequence[int], int]:
    """A border, the masses, a border, and what a sweep reads behind it."""
    return range(1, string.masses + 1), padded(string.masses + 3)


STRING = PartType(
    _select,
    _build,
    live_structures,
    _layout,
    name="strings",
    compiled_as="a stencil over contiguous memory, many masses at once; only those under links are asked for a force",
    moves_points=True,
)


@action
def initialize(strings, state):
    """A free end's border follows its neighbour."""
    strings, state = value_of(strings), value_of(state)
    for s in range(np.uint64(strings.rows.border.size)):
        free_ends(strings.rows, s, state.previous)


@action
def integrate(strings, state):
    """Moves every string by one sample."""
    strings, state = value_of(strings), value_of(state)
    rows = strings.rows
    for s in range(np.uint64(rows.border.size)):
        free_ends(rows, s, state.position)
        step = StringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
        )
        first = rows.border[s] + np.uint64(1)
        sweep(step, state.position, state.previous, state.following, first, rows.masses[s])
    push_loaded_points(strings.loaded, state)


@inlined
def free_ends(rows, s, position):
    """The border of a free end goes where its neighbour is."""
    left, right = rows.border[s], rows.border[s] + rows.masses[s] + np.uint64(1)
    if rows.free[s, 0]:
        put_one(position, left, position[left + np.uint64(1)])
    if rows.free[s, 1]:
        put_one(position, right, position[right - np.uint64(1)])


@fma
def coefficient_terms(step, x, before):
    """What is s[n] and s[n-1] to a neighbour, of a string or a membrane."""
    return ((step.a + step.b) * x - step.b * before,)


@fma
def _update_by_coefficients(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    real = rows[0].dtype.type
    now, old = real(2) - real(2) * (a + b) - e, real(1) - real(2) * b - e
    return (now * x - old * before) + (shift_lanes(terms, 0, -1) + shift_lanes(terms, 0, 1))


@inlined
def place_terms(step, x, before):  # noqa: ARG001  (every step's)
    """Where masses are and were, for steps that work out differences."""
    return x, before


@fma
def _update_by_differences(step, rows, here, terms):
    x, before = fetch(rows[0], here), fetch(rows[1], here)
    a, b, e = step
    two = rows[0].dtype.type(2)
    way = x - before
    pull = (shift_lanes(terms, 0, -1) + shift_lanes(terms, 0, 1)) - two * x
    pull_before = (shift_lanes(terms, 1, -1) + shift_lanes(terms, 1, 1)) - two * before
    return x + (((way - e * way) + (a + b) * pull) - b * pull_before)


stencil_kernel(
    StringStep,
    StencilKernel(coefficient_terms, _update_by_coefficients),
    StencilKernel(place_terms, _update_by_differences),
)
