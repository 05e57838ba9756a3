"""The centred damper: g[n] = (d[n] - d[n-2])/2, what d grew in the middle of the last two sample periods."""

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


class CentredLinks(NamedTuple):
    """L links; `older`: d two samples before the next tick, m, shape (L,)."""

    links: Links
    older: Column


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], frame: Frame) -> CentredLinks:
    return CentredLinks(links_of(links, columns, frame), np.zeros(len(links), frame.real))


CENTRED = Kind(
    with_damper("centred"),
    _build,
    live_links,
    name="visco-elastic links (centred damper)",
    compiled_as="gathered through unsigned indices; one remembered stretch each",
)


@settles(CentredLinks)
@inlined
def settle_centred(group, moment):
    """Before the first tick: as if every point had moved up to now as it does."""
    ends = group.links.ends
    for i in range(count(ends)):
        before = stretch(ends, i, moment.previous)
        group.older[i] = before + (before - stretch(ends, i, moment.position))


@pulls(CentredLinks)
@inlined
def pull_centred(group, moment):
    """Adds the force of every link."""
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, moment.position)
        growth = np.float32(0.5) * (d - group.older[i])  # exact in either precision, and takes neither to the other
        pull_link(group.links, i, d, growth, moment.force)
        group.older[i] = stretch(ends, i, moment.previous)
