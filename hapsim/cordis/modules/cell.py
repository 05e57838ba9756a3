"""The cell: a mass on a spring and a damper of its own (CORDIS: CEL).

    F[n] = -K d[n] - (B/T) (d[n] - d[n-1]),      d: where it is minus where it rests

It moves as the mass of `mass.py` does, in the same pass. Where its rest position is moved while the scene runs, d grows
by that too: a cell is a mass, a visco-elastic link and a ground, and not an instruction more than these need where no
name is looked up.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Memory, Part, action
from hapsim.cordis.tick_state import Column
from hapsim.scene import Cell


class Cells(NamedTuple):
    """C cells, which stand together from point `start` on: K and B/T in N/m, rest in m, shape (C,).

    `rest_before`: m, of the sample before, shape (C,).
    """

    start: np.uint64
    stiffness: Column
    damping_per_sample: Column
    rest: Column
    rest_before: Column


@action
def add_forces(group, state):
    """Adds the force of every cell's own spring and damper."""
    group, state = value_of(group), value_of(state)
    first, last = group.start, group.start + np.uint64(group.rest.size)
    position, previous, force = state.position[first:last], state.previous[first:last], state.force[first:last]
    for i in range(np.uint64(group.rest.size)):
        d = position[i] - group.rest[i]
        growth = d - (previous[i] - group.rest_before[i])
        force[i] -= group.stiffness[i] * d + group.damping_per_sample[i] * growth
        group.rest_before[i] = group.rest[i]


def _live(cells: Sequence[Cell], rate: float) -> list[list[float]]:
    """K, B/T, and where they rest."""
    return [
        [one.stiffness for one in cells],
        [one.damping * rate for one in cells],
        [one.rest for one in cells],
    ]


def _build(cells: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
    stiffness, damping, rest = columns
    start = np.uint64(context.number[next(iter(cells))])
    before = rest.copy()
    numbers = Cells(start, stiffness, damping, rest, before)
    return Part(numbers, add_forces=add_forces, memory=Memory(tuple(cells), (before,)))


CELL = PartType(
    all_of(Cell),
    _build,
    _live,
    name="cells",
    compiled_as="pulled to rest in one pass, without a name being looked up; they move with the masses",
    memoryless=True,
)
