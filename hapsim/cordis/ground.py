"""The ground: a point that stays where it is put, and moves only where its rest position is changed (CORDIS: SOL).

While it moves, its velocity is felt through the dampers that are tied to it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapsim.compiled import inlined
from hapsim.cordis.kind import Column, Frame, Kind, all_of
from hapsim.scene import Ground


class Grounds(NamedTuple):
    """G grounds, which stand together from point `start` on; `rest`: m, shape (G,)."""

    start: int
    rest: Column


def _live(grounds: Sequence[Ground], _rate: float) -> list[list[float]]:
    """Where they stand, in m."""
    return [[ground.position for ground in grounds]]


def _build(grounds: Mapping[str, Ground], columns: Sequence[Column], frame: Frame) -> Grounds:
    return Grounds(frame.number[next(iter(grounds))], columns[0])


GROUND = Kind(
    all_of(Ground), _build, _live, name="grounds", compiled_as="points that nothing moves; no force is kept for them"
)


@inlined
def settle(grounds, moment):
    """Puts every ground to its rest position: to be called with each sample in which one moves, and with the next.

    Between, they stand still by themselves: all rows of positions have them where they are.
    """
    if grounds is None:
        return
    for i in range(grounds.rest.size):
        p = grounds.start + i
        moment.previous[p] = moment.position[p]
        moment.position[p] = moment.following[p] = grounds.rest[i]
