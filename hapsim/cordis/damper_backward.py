"""The backward damper: first-order Euler, g[n] = d[n] - d[n-1] (Florens et al., §6)."""

from __future__ import annotations

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.kind import Kind
from hapsim.cordis.link import Links, count, stretch
from hapsim.cordis.viscoelastic import links_of, live_links, pull_link, with_damper

BACKWARD = Kind(
    with_damper("backward"),
    links_of,
    live_links,
    name="visco-elastic links",
    compiled_as="gathered through unsigned indices",
    forgets=True,
)


@pulls(Links)
@inlined
def pull_backward(links, moment):
    """Adds the force of every link."""
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, moment.position)
        pull_link(links, i, d, d - stretch(links.ends, i, moment.previous), moment.force)
