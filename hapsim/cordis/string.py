"""The string: equal masses in a row, moved in one pass over contiguous memory.

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
from hapsim.cordis.mass import mobility_of
from hapsim.cordis.stencil import steps, sweep
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
    """A border, the masses, a border."""
    return range(1, string.masses + 1), string.masses + 2


STRING = Kind(
    _select,
    _build,
    live_structures,
    _layout,
    name="strings",
    compiled_as="a stencil over contiguous memory; only the masses that links hold are asked for a force",
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
        first, size = rows.border[s], rows.masses[s] + np.uint64(2)
        step = StringStep(
            strings.mobility[s] * strings.stiffness[s],
            strings.mobility[s] * strings.damping_per_sample[s],
            strings.mobility[s] * strings.friction_per_sample[s],
        )
        sweep(
            step,
            moment.position[first : first + size],
            moment.previous[first : first + size],
            moment.following[first : first + size],
            np.uint64(1),
            rows.masses[s],
        )
    push_held(strings.held, moment)


@inlined
def free_ends(rows, s, position):
    """The border of a free end goes where its neighbour is."""
    left, right = rows.border[s], rows.border[s] + rows.masses[s] + np.uint64(1)
    if rows.free[s, 0]:
        position[left] = position[left + np.uint64(1)]
    if rows.free[s, 1]:
        position[right] = position[right - np.uint64(1)]


@fused
def _by_coefficients(step, x, before, after, here):
    real = x.dtype.type
    a, b, e = step
    left, right = here - np.uint64(1), here + np.uint64(1)
    now, old = real(2) - real(2) * (a + b) - e, real(1) - real(2) * b - e
    after[here] = (
        now * x[here] + (a + b) * (x[left] + x[right]) - old * before[here] - b * (before[left] + before[right])
    )


@fused
def _by_differences(step, x, before, after, here):
    real = x.dtype.type
    a, b, e = step
    left, right = here - np.uint64(1), here + np.uint64(1)
    way = x[here] - before[here]
    pull = (x[left] + x[right]) - real(2) * x[here]
    pull_before = (before[left] + before[right]) - real(2) * before[here]
    after[here] = x[here] + (((way - e * way) + (a + b) * pull) - b * pull_before)


steps(StringStep, _by_coefficients, _by_differences)
