"""The centred damper: g[n] = (d[n] - d[n-2])/2, what d grew in the middle of the last two sample periods."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.viscoelastic import Links, pull, stretch


class CentredLinks(NamedTuple):
    """L links; `older`: d two samples before the next tick, m, shape (L,)."""

    links: Links
    older: NDArray[np.float64]


def centred_links(links: Links) -> CentredLinks:
    """Links at rest until `settle_centred` was called."""
    return CentredLinks(links, np.zeros(links.first.size))


@inlined
def settle_centred(group, position, previous):
    """Before the first tick: as if every point had moved up to now as it does."""
    if group is None:
        return
    for i in range(group.older.size):
        group.older[i] = 2.0 * stretch(group.links, i, previous) - stretch(group.links, i, position)


@inlined
def pull_centred(group, position, previous, force):
    """Adds the force of every link."""
    if group is None:
        return
    for i in range(group.older.size):
        d = stretch(group.links, i, position)
        pull(group.links, i, d, 0.5 * (d - group.older[i]), force)
        group.older[i] = stretch(group.links, i, previous)
