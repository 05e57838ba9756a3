"""The membrane: equal masses in rows and columns, moved in one pass over contiguous memory.

The recurrence is that of `string.py`, with four neighbours: s[i] = x[left] + x[right] + x[above] + x[below],

    x[n+1] = (2 - 4 (a + b) - e) x[n] + (a + b) s[n] - (1 - 4 b - e) x[n-1] - b s[n-1]

A membrane is in memory row after row, each between two borders, and between two rows of borders above and below. The
border of a fixed edge stays at its place; that of a free edge follows its neighbour, so that no link to it is ever
stretched. Every row is aligned for lanes, so that the rows above and below are fetched in whole lanes.

Rows are moved from the top down, and x[n+1] replaces x[n-1]. So the terms of the row above are kept.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from hapsim.cordis.simd import aligned, fetch, padded, put, put_one, width_of
from hapsim.scene import Membrane


class Membranes(NamedTuple):
    """S membranes: first mass, distance in memory from row to row, rows and columns of masses, shape (S,), and which
    edges are free (S, 4). `above`: room for the terms of the longest row."""

    first: NDArray[np.uint64]
    pitch: NDArray[np.uint64]
    rows: NDArray[np.uint64]
    columns: NDArray[np.uint64]
    free: NDArray[np.bool_]
    above: Column
    links: UniformLinks
    loaded: LoadedPoints


class MembraneStep(NamedTuple):
    """`a`, `b`, `e` as above; `pitch`: from one row to the next in memory; `above`: the terms of the row above the one
    that begins at `row`, borders and all."""

    a: float
    b: float
    e: float
    pitch: np.uint64
    above: Column
    row: np.uint64


def _numbers(
    membranes: Mapping[str, Any], links: UniformLinks, loaded: LoadedPoints, context: BuildContext
) -> Membranes:
    firsts = [context.number[f"{name}.0.0"] for name in membranes]
    counts = [(_pitch(one), one.rows, one.columns) for one in membranes.values()]
    free = np.array([[edge == "free" for edge in one.edges] for one in membranes.values()])
    pitch, rows, columns = np.array(counts, np.uint64).T.copy()
    above = aligned(np.zeros(int(pitch.max())), context.real)
    return Membranes(np.array(firsts, np.uint64), pitch, rows, columns, free, above, links, loaded)


def _pitch(membrane: Membrane) -> int:
    """Returns the padded size of a border, a row of masses and a border."""
    return padded(membrane.columns + 2)


def _layout(membrane: Membrane) -> tuple[Sequence[int], int]:
    """Returns the layout: rows with a border at each end, between two rows of borders."""
    rows, columns, pitch = range(1, membrane.rows + 1), range(1, membrane.columns + 1), _pitch(membrane)
    return [row * pitch + column for row in rows for column in columns], (membrane.rows + 2) * pitch


@action
def initialize(membranes, state):
    """Places the borders at the earlier positions of the masses."""
    membranes, state = value_of(membranes), value_of(state)
    for s in range(np.uint64(membranes.first.size)):
        _free_edges(membranes, s, state.previous)


@action
def integrate(membranes, state):
    """Moves every membrane by one sample."""
    membranes, state = value_of(membranes), value_of(state)
    for s in range(np.uint64(membranes.first.size)):
        _free_edges(membranes, s, state.position)
        a, b, e = link_coefficients(membranes.links, s)
        pitch, first = membranes.pitch[s], membranes.first[s]
        begin = first & ~(width_of(membranes.above) - np.uint64(1))
        _keep_borders(MembraneStep(a, b, e, pitch, membranes.above, begin), state)
        for row in range(membranes.rows[s]):
            way = row * pitch
            sweep(MembraneStep(a, b, e, pitch, membranes.above, begin + way), state, first + way, membranes.columns[s])
    push_loaded_points(membranes.loaded, state)


@inlined
def _free_edges(membranes, s, position):
    """Places the border of a free edge at its neighbour."""
    first, pitch, columns, free = membranes.first[s], membranes.pitch[s], membranes.columns[s], membranes.free
    last_row = first + (membranes.rows[s] - np.uint64(1)) * pitch
    if free[s, 0]:
        _copy_row(position, first, first - pitch, columns)
    if free[s, 1]:
        _copy_row(position, last_row, last_row + pitch, columns)
    for row in range(membranes.rows[s]):
        left = first + row * pitch
        right = left + columns - np.uint64(1)
        if free[s, 2]:
            put_one(position, left - np.uint64(1), position[left])
        if free[s, 3]:
            put_one(position, right + np.uint64(1), position[right])


@inlined
def _keep_borders(step, state):
    """Keeps the terms of the row of borders above."""
    for i in range(np.uint64(0), step.pitch, width_of(step.above)):
        put(step.above, i, _terms_at(step, (state.position, state.previous), step.row - step.pitch + i))


@inlined
def _terms_at(step, rows, place):
    return linear_terms(step, fetch(rows[0], place), fetch(rows[1], place))[0]


@inlined
def _copy_row(position, masses, borders, columns):
    """Copies a row of masses to a row of borders, in lanes, with the numbers beside them."""
    begin, end = np.uint64(1), columns + np.uint64(1)
    for i in range(np.uint64(0), end, width_of(position)):
        put(position, borders - begin + i, fetch(position, masses - begin + i))


@fma
def _update(step, rows, here, terms):
    """Keeps the terms here for the row below, beside the result."""
    (t, x, before), column = terms[1], here - step.row
    above = fetch(step.above, column)
    put(step.above, column, t)
    neighbouring = neighbours(terms, 0) + (above + _terms_at(step, rows, here + step.pitch))
    return next_position(step, x, before, neighbouring - rows[0].dtype.type(4) * t)


STENCIL_KERNELS[MembraneStep] = StencilKernel(linear_terms, _update)

MEMBRANE = structure_type(
    Membrane, _numbers, _layout, initialize, integrate, "membranes", "a stencil over contiguous memory, row by row"
)
