"""The ground: a point that stays where it is put, and moves only where its rest position is changed (CORDIS: SOL).

While it moves, its velocity is felt through the dampers that are tied to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.tick_state import Column
from hapsim.scene import Ground


class Grounds(NamedTuple):
    """G grounds, which stand together from point `start` on; `rest`: m, shape (G,)."""

    start: np.uint64
    rest: Column


@action
def retarget(grounds, state):
    """Puts every ground to its rest position. Between, they stand still by themselves: all rows of positions have them
    where they are."""
    grounds, state = value_of(grounds), value_of(state)
    for i in range(np.uint64(grounds.rest.size)):
        p = grounds.start + i
        state.previous[p] = state.position[p]
        state.position[p] = state.following[p] = grounds.rest[i]


def _live(grounds: Sequence[Ground], _rate: float) -> list[list[float]]:
    """Where they stand, in m."""
    return [[ground.position for ground in grounds]]


def _build(grounds: Mapping[str, Ground], columns: Sequence[Column], context: BuildContext) -> Part:
    start = np.uint64(context.number[next(iter(grounds))])
    return Part(Grounds(start, columns[0]), retarget=retarget)


GROUND = PartType(
    all_of(Ground), _build, _live, name="grounds", compiled_as="points that nothing moves; a tick does not ask for them"
)
