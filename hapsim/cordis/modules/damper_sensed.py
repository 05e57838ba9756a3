"""The sensed damper: g[n] = T v[n], where v is the velocity that the device measures.

A link's end that is no device point has no sensor: there g is the backward difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling import inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part, fma_action
from hapsim.cordis.modules.link import count, stretch
from hapsim.cordis.modules.viscoelastic import Links, links_of, live_links, pull_link, with_damper
from hapsim.cordis.tick_state import Column
from hapsim.scene import ViscoElastic


class SensedLinks(NamedTuple):
    """L links; `period`: T in s, shape (1,)."""

    links: Links
    period: Column


@fma_action
def add_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends, period = group.links.ends, group.period[0]
    for i in range(count(ends)):
        growth = _step(ends.first[i], period, state) - _step(ends.second[i], period, state)
        pull_link(group.links, i, stretch(ends, i, state.position), growth, state.force)


@inlined
def _step(point, period, state):
    """How far a point moves in a sample period, by its sensor where it has one: device points do, and come first."""
    if point < state.velocity.size:
        return state.position.dtype.type(period * state.velocity[point])
    return state.position[point] - state.previous[point]


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Part:
    numbers = SensedLinks(links_of(links, columns, context), np.array([1.0 / context.rate], context.real))
    return Part(numbers, add_forces=add_forces)


SENSED = PartType(
    with_damper("sensed"),
    _build,
    live_links,
    name="visco-elastic links (sensed damper)",
    compiled_as="gathered through unsigned indices; velocities come from the device",
    memoryless=True,
)
