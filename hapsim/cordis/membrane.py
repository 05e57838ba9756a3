"""The membrane: equal masses in rows and columns, moved in one pass over contiguous memory.

The recurrence is that of `string.py`, with four neighbours: s[i] = x[left] + x[right] + x[above] + x[below],

    x[n+1] = (2 - 4 (a + b) - e) x[n] + (a + b) s[n] - (1 - 4 b - e) x[n-1] - b s[n-1]

A membrane stands in memory row after row, each between two borders, and between two rows of borders above and below.
The border of an edge that is held stays where it is; that of a free edge follows its neighbour, so that no link to it
is ever stretched. The pass goes on from each row to the next across their borders and moves these like masses; before
each sample they are put back.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, settles
from hapsim.cordis.held import Held, held_of, push_held
from hapsim.cordis.kind import Column, Frame, Kind, all_of
from hapsim.cordis.mass import mobility_of
from hapsim.cordis.stencil import steps, sweep
from hapsim.cordis.string import live_structures
from hapsim.scene import Membrane


class Membranes(NamedTuple):
    """S membranes: where their memory begins, how many rows and columns of masses each has, which edges are free
    (S, 4); where the others rest, in m; T²/m in m/N; K, B/T and friction/T in N/m; shape (S,)."""

    begin: NDArray[np.uint64]
    rows: NDArray[np.uint64]
    columns: NDArray[np.uint64]
    free: NDArray[np.bool_]
    rest: Column
    mobility: Column
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column
    held: Held | None


class MembraneStep(NamedTuple):
    """`a`, `b`, `e` as above; `pitch`: from one row to the next in memory."""

    a: float
    b: float
    e: float
    pitch: np.uint64


def _build(membranes: Mapping[str, Membrane], columns: Sequence[Column], frame: Frame) -> Membranes:
    ones = membranes.values()
    stiffness, damping, friction = columns
    return Membranes(
        np.array([frame.number[f"{name}.0.0"] - one.columns - 3 for name, one in membranes.items()], np.uint64),
        np.array([one.rows for one in ones], np.uint64),
        np.array([one.columns for one in ones], np.uint64),
        np.array([[edge == "free" for edge in one.edges] for one in ones]),
        frame.column([one.position for one in ones]),
        mobility_of([one.mass for one in ones], frame),
        stiffness,
        damping,
        friction,
        held_of(membranes, frame),
    )


def _layout(membrane: Membrane) -> tuple[Sequence[int], int]:
    """Rows with a border at each end, between two rows of borders."""
    rows, columns, pitch = range(1, membrane.rows + 1), range(1, membrane.columns + 1), membrane.columns + 2
    return [row * pitch + column for row in rows for column in columns], (membrane.rows + 2) * pitch


MEMBRANE = Kind(
    all_of(Membrane),
    _build,
    live_structures,
    _layout,
    name="membranes",
    compiled_as="a stencil over contiguous memory, across the rows",
)


@settles(Membranes)
@inlined
def settle_membranes(membranes, moment):
    """Before the first tick: the borders go where the masses were."""
    for s in range(membranes.begin.size):
        _place_borders(membranes, s, moment.previous)


@moves(Membranes)
@inlined
def advance_membranes(membranes, moment):
    """Moves every membrane by one sample."""
    for s in range(membranes.begin.size):
        _place_borders(membranes, s, moment.position)
        begin, pitch = membranes.begin[s], membranes.columns[s] + np.uint64(2)
        size = (membranes.rows[s] + np.uint64(2)) * pitch
        step = MembraneStep(
            membranes.mobility[s] * membranes.stiffness[s],
            membranes.mobility[s] * membranes.damping_per_sample[s],
            membranes.mobility[s] * membranes.friction_per_sample[s],
            pitch,
        )
        sweep(
            step,
            moment.position[begin : begin + size],
            moment.previous[begin : begin + size],
            moment.following[begin : begin + size],
            pitch + np.uint64(1),
            membranes.rows[s] * pitch - np.uint64(2),
        )
    push_held(membranes.held, moment)


@inlined
def _place_borders(membranes, s, position):
    """The border of a held edge goes back to where it rests, that of a free one to where its neighbour is."""
    pitch, rest = membranes.columns[s] + np.uint64(2), membranes.rest[s]
    first = membranes.begin[s] + pitch + np.uint64(1)
    right = membranes.columns[s] - np.uint64(1)
    below = (membranes.rows[s] - np.uint64(1)) * pitch
    if membranes.free[s, 0]:
        for i in range(membranes.columns[s]):
            position[first - pitch + i] = position[first + i]
    if membranes.free[s, 1]:
        for i in range(membranes.columns[s]):
            position[first + below + pitch + i] = position[first + below + i]
    for row in range(membranes.rows[s]):
        left = first + row * pitch
        position[left - np.uint64(1)] = position[left] if membranes.free[s, 2] else rest
        position[left + right + np.uint64(1)] = position[left + right] if membranes.free[s, 3] else rest


@fused
def _by_coefficients(step, x, before, after, here):
    real = x.dtype.type
    a, b, e, pitch = step
    left, right, above, below = here - np.uint64(1), here + np.uint64(1), here - pitch, here + pitch
    now, old = real(2) - real(4) * (a + b) - e, real(1) - real(4) * b - e
    after[here] = (
        now * x[here]
        + (a + b) * ((x[left] + x[right]) + (x[above] + x[below]))
        - old * before[here]
        - b * ((before[left] + before[right]) + (before[above] + before[below]))
    )


@fused
def _by_differences(step, x, before, after, here):
    a, b, e, pitch = step
    way = x[here] - before[here]
    pull, pull_before = _pull(x, here, pitch), _pull(before, here, pitch)
    after[here] = x[here] + (((way - e * way) + (a + b) * pull) - b * pull_before)


@fused
def _pull(x, here, pitch):
    """By how much the four neighbours together are away."""
    real = x.dtype.type
    neighbours = (x[here - np.uint64(1)] + x[here + np.uint64(1)]) + (x[here - pitch] + x[here + pitch])
    return neighbours - real(4) * x[here]


steps(MembraneStep, _by_coefficients, _by_differences)
