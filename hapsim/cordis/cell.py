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
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.kind import Column, Frame, Kind, all_of
from hapsim.scene import Cell


class Cells(NamedTuple):
    """C cells, which stand together from point `start` (1,) on: K and B/T in N/m, rest in m, shape (C,).

    `rest_before`: m, of the sample before, shape (C,).
    """

    start: NDArray[np.uint64]
    stiffness: Column
    damping_per_sample: Column
    rest: Column
    rest_before: Column


def _live(cells: Sequence[Cell], rate: float) -> list[list[float]]:
    """K, B/T, and where they rest."""
    return [
        [one.stiffness for one in cells],
        [one.damping * rate for one in cells],
        [one.rest for one in cells],
    ]


def _build(cells: Mapping[str, Any], columns: Sequence[Column], frame: Frame) -> Cells:
    stiffness, damping, rest = columns
    start = np.array([frame.number[next(iter(cells))]], np.uint64)
    return Cells(start, stiffness, damping, rest, rest.copy())


CELL = Kind(
    all_of(Cell),
    _build,
    _live,
    name="cells",
    compiled_as="pulled home in one pass, without a name being looked up; they move with the masses",
    forgets=True,
)


@pulls(Cells)
@inlined
def pull_home(group, moment):
    """Adds the force of every cell's own spring and damper."""
    first, last = group.start[0], group.start[0] + np.uint64(group.rest.size)
    position, previous, force = moment.position[first:last], moment.previous[first:last], moment.force[first:last]
    for i in range(group.rest.size):
        d = position[i] - group.rest[i]
        growth = d - (previous[i] - group.rest_before[i])
        force[i] -= group.stiffness[i] * d + group.damping_per_sample[i] * growth
        group.rest_before[i] = group.rest[i]
