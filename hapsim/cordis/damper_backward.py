"""The backward damper: first-order Euler, g[n] = d[n] - d[n-1] (Florens et al., §6)."""

from __future__ import annotations

from hapsim.compiled import inlined
from hapsim.cordis.viscoelastic import pull, stretch


@inlined
def pull_backward(links, position, previous, force):
    """Adds the force of every link."""
    if links is None:
        return
    for i in range(links.first.size):
        d = stretch(links, i, position)
        pull(links, i, d, d - stretch(links, i, previous), force)
