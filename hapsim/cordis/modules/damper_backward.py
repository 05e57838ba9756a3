"""The backward damper: first-order Euler, g[n] = d[n] - d[n-1] (Florens et al., §6)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part, fma_action
from hapsim.cordis.modules.link import count, stretch
from hapsim.cordis.modules.viscoelastic import links_of, live_links, pull_link, with_damper
from hapsim.cordis.tick_state import Column
from hapsim.scene import ViscoElastic


@fma_action
def add_forces(links, state):
    """Adds the force of every link."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        pull_link(links, i, d, d - stretch(links.ends, i, state.previous), state.force)


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], context: BuildContext) -> Part:
    return Part(links_of(links, columns, context), add_forces=add_forces)


BACKWARD = PartType(
    with_damper("backward"),
    _build,
    live_links,
    name="visco-elastic links",
    compiled_as="gathered through unsigned indices",
    memoryless=True,
    in_a_matrix=lambda link: (link.stiffness, link.damping),
)
