"""The spring (CORDIS: RES).

F[n] = K d[n]      pulls the ends together; d: first end minus second
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.cordis.tick_state import Column
from hapsim.scene import Spring


class Springs(NamedTuple):
    """L springs: K in N/m, shape (L,)."""

    ends: Ends
    stiffness: Column


@action
def add_forces(springs, state):
    """Adds the force of every spring."""
    springs, state = value_of(springs), value_of(state)
    for i in range(count(springs.ends)):
        tension = springs.stiffness[i] * stretch(springs.ends, i, state.position)
        pull_ends(springs.ends, i, tension, state.force)


def _live(springs: Sequence[Spring], _rate: float) -> list[list[float]]:
    """K."""
    return [[one.stiffness for one in springs]]


def _build(springs: Mapping[str, Spring], columns: Sequence[Column], context: BuildContext) -> Part:
    return Part(Springs(ends_of(springs, context), *columns), add_forces=add_forces)


SPRING = PartType(
    all_of(Spring),
    _build,
    _live,
    name="springs",
    compiled_as="gathered through unsigned indices; no previous positions are read",
    memoryless=True,
    in_a_matrix=lambda spring: (spring.stiffness, 0.0),
)
