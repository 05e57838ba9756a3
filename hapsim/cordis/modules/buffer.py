"""The buffer: a contact from one side (CORDIS: BUT).

    p[n] = distance - d[n]                                  how deep the first end is below the second
    push[n] = max(0, K p[n] + (B/T) (p[n] - p[n-1]))  where p[n] > 0, else 0

The push drives the ends apart: as a tension it is F = -push, which the code works out from d - distance = -p. It never
pulls: a damper would hold back what leaves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.scene import Buffer


class Buffers(NamedTuple):
    """L buffers: K and B/T in N/m, distance in m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    distance: Column


@action
def add_forces(group, state):
    """Adds the force of every buffer that is touched."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        d = stretch(group.ends, i, state.position)
        if not d >= group.distance[i]:  # what is not a number goes on to the guard
            growth = d - stretch(group.ends, i, state.previous)
            tension = group.stiffness[i] * (d - group.distance[i]) + group.damping_per_sample[i] * growth
            if not tension > 0:
                pull_ends(group.ends, i, tension, state.force)


def _build(buffers: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
    return Part(Buffers(ends_of(buffers, context), *columns), add_forces=add_forces)


BUFFER = PartType(
    all_of(Buffer),
    _build,
    name="buffers",
    compiled_as="gathered through unsigned indices; one comparison each",
    memoryless=True,
)
