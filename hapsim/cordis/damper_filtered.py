"""The filtered damper: the backward difference behind a first-order low-pass.

g[n] = k g[n-1] + (1 - k) (d[n] - d[n-1]),      k = exp(-2 pi cutoff T)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls, settles
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.link import Links, count, stretch
from hapsim.cordis.viscoelastic import links_of, live_links, pull_link, with_damper
from hapsim.scene import ViscoElastic


class FilteredLinks(NamedTuple):
    """L links; `kept`: k; `growth`: g of the last tick, m; shape (L,) both."""

    links: Links
    kept: Column
    growth: Column


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], frame: Frame) -> FilteredLinks:
    cutoff = np.array([link.cutoff for link in links.values()], np.float64)  # Hz
    kept = np.exp(-2.0 * np.pi * cutoff / frame.rate).astype(frame.real)
    return FilteredLinks(links_of(links, columns, frame), kept, np.zeros(len(links), frame.real))


FILTERED = Kind(
    with_damper("filtered"),
    _build,
    live_links,
    name="visco-elastic links (filtered damper)",
    compiled_as="gathered through unsigned indices; one remembered velocity each",
)


@settles(FilteredLinks)
@inlined
def settle_filtered(group, moment):
    """Before the first tick: as if every point had moved up to now as it does."""
    ends = group.links.ends
    for i in range(count(ends)):
        group.growth[i] = stretch(ends, i, moment.position) - stretch(ends, i, moment.previous)


@pulls(FilteredLinks)
@inlined
def pull_filtered(group, moment):
    """Adds the force of every link."""
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, moment.position)
        newest = d - stretch(ends, i, moment.previous)
        group.growth[i] = newest + group.kept[i] * (group.growth[i] - newest)
        pull_link(group.links, i, d, group.growth[i], moment.force)
