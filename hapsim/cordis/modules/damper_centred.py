"""The centred damper: g[n] = (d[n] - d[n-2])/2, what d grew in the middle of the last two sample periods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Memory, Part, action, fma_action
from hapsim.cordis.modules.link import count, stretch
from hapsim.cordis.modules.viscoelastic import Links, links_of, live_links, pull_link, with_damper
from hapsim.cordis.tick_state import Column
from hapsim.scene import ViscoElastic


class CentredLinks(NamedTuple):
    """L links; `older`: d two samples before the next tick, m, shape (L,)."""

    links: Links
    older: Column


@action
def initialize(group, state):
    """As if every point had moved up to now as it does."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        before = stretch(ends, i, state.previous)
        group.older[i] = before + (before - stretch(ends, i, state.position))


@fma_action
def add_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        growth = np.float32(0.5) * (d - group.older[i])  # exact in either precision, and takes neither to the other
        pull_link(group.links, i, d, growth, state.force)
        group.older[i] = stretch(ends, i, state.previous)


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Part:
    older = np.zeros(len(links), context.real)
    numbers = CentredLinks(links_of(links, columns, context), older)
    return Part(numbers, initialize=initialize, add_forces=add_forces, memory=Memory(tuple(links), (older,)))


CENTRED = PartType(
    with_damper("centred"),
    _build,
    live_links,
    name="visco-elastic links (centred damper)",
    compiled_as="gathered through unsigned indices; one remembered stretch each",
)
