"""The filtered damper: the backward difference behind a first-order low-pass.

g[n] = k g[n-1] + (1 - k) (d[n] - d[n-1]),      k = exp(-2 pi cutoff T)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.viscoelastic import Links, pull, stretch


class FilteredLinks(NamedTuple):
    """L links; `kept`: k; `growth`: g of the last tick, m; shape (L,) both."""

    links: Links
    kept: NDArray[np.float64]
    growth: NDArray[np.float64]


def filtered_links(links: Links, cutoff: Sequence[float], rate: float) -> FilteredLinks:
    """Links at rest until `settle_filtered` was called. `cutoff` and `rate` in Hz."""
    kept = np.exp(-2.0 * np.pi * np.array(cutoff, np.float64) / rate)
    return FilteredLinks(links, kept, np.zeros(links.first.size))


@inlined
def settle_filtered(group, position, previous):
    """Before the first tick: as if every point had moved up to now as it does."""
    if group is None:
        return
    for i in range(group.growth.size):
        group.growth[i] = stretch(group.links, i, position) - stretch(group.links, i, previous)


@inlined
def pull_filtered(group, position, previous, force):
    """Adds the force of every link."""
    if group is None:
        return
    for i in range(group.growth.size):
        d = stretch(group.links, i, position)
        newest = d - stretch(group.links, i, previous)
        group.growth[i] = newest + group.kept[i] * (group.growth[i] - newest)
        pull(group.links, i, d, group.growth[i], force)
