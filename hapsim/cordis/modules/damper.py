"""The damper (CORDIS: FRO), by the backward difference.

F[n] = (B/T) (d[n] - d[n-1])      pulls the ends together; d: first end minus second
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.cordis.tick_state import Column
from hapsim.scene import Damper


class Dampers(NamedTuple):
    """L dampers: B/T in N/m, shape (L,)."""

    ends: Ends
    damping_per_sample: Column


@action
def add_forces(dampers, state):
    """Adds the force of every damper."""
    dampers, state = value_of(dampers), value_of(state)
    for i in range(count(dampers.ends)):
        growth = stretch(dampers.ends, i, state.position) - stretch(dampers.ends, i, state.previous)
        pull_ends(dampers.ends, i, dampers.damping_per_sample[i] * growth, state.force)


def _live(dampers: Sequence[Damper], rate: float) -> list[list[float]]:
    """B/T."""
    return [[one.damping * rate for one in dampers]]


def _build(dampers: Mapping[str, Damper], columns: Sequence[Column], context: BuildContext) -> Part:
    return Part(Dampers(ends_of(dampers, context), *columns), add_forces=add_forces)


DAMPER = PartType(
    all_of(Damper),
    _build,
    _live,
    name="dampers",
    compiled_as="gathered through unsigned indices; no stiffness is carried",
    memoryless=True,
    in_a_matrix=lambda damper: (0.0, damper.damping),
)
