"""The filtered damper: the backward difference behind a first-order low-pass.

g[n] = k g[n-1] + (1 - k) (d[n] - d[n-1]),      k = exp(-2 pi cutoff T)
"""

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


class FilteredLinks(NamedTuple):
    """L links; `kept`: k; `growth`: g of the last tick, m; shape (L,) both."""

    links: Links
    kept: Column
    growth: Column


@action
def initialize(group, state):
    """As if every point had moved up to now as it does."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        group.growth[i] = stretch(ends, i, state.position) - stretch(ends, i, state.previous)


@fma_action
def add_forces(group, state):
    """Adds the force of every link."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        newest = d - stretch(ends, i, state.previous)
        group.growth[i] = newest + group.kept[i] * (group.growth[i] - newest)
        pull_link(group.links, i, d, group.growth[i], state.force)


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Part:
    cutoff = np.array([link.cutoff for link in links.values()], np.float64)  # Hz
    kept = np.exp(-2.0 * np.pi * cutoff / context.rate).astype(context.real)
    growth = np.zeros(len(links), context.real)
    numbers = FilteredLinks(links_of(links, columns, context), kept, growth)
    return Part(numbers, initialize=initialize, add_forces=add_forces, memory=Memory(tuple(links), (growth,)))


FILTERED = PartType(
    with_damper("filtered"),
    _build,
    live_links,
    name="visco-elastic links (filtered damper)",
    compiled_as="gathered through unsigned indices; one remembered velocity each",
)
