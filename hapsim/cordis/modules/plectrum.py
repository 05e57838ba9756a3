"""The plectrum: a visco-elastic link that releases.

    F[n] = K d[n] + (B/T) (d[n] - d[n-1])  while it grips, else 0

F pulls the ends together; d: first end minus second end. It grips while |d[n]| <= release. Beyond, it releases, and
remembers on which side; it grips again at the first sample where d is 0 or on the other side, unless that is beyond
`release` too. At the start it grips if |d| <= release.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Memory, Part, action
from hapsim.cordis.modules.link import Links, count, ends_of, pull_link, stretch
from hapsim.scene import Plectrum


class Plectra(NamedTuple):
    """L plectra; `release`: m, shape (L,). `side`: 1 or -1, on which side it released, or 0 where it grips."""

    links: Links
    release: Column
    side: Column


@action
def add_forces(group, state):
    """Adds the force of every link that grips."""
    group, state = value_of(group), value_of(state)
    ends = group.links.ends
    for i in range(count(ends)):
        d = stretch(ends, i, state.position)
        if not group.side[i] * d > 0:  # it grips, or its ends have met; what is not a number goes on to the guard
            if abs(d) > group.release[i]:
                group.side[i] = 1 if d > 0 else -1
            else:
                group.side[i] = 0
                pull_link(group.links, i, d, d - stretch(ends, i, state.previous), state.force)


def _build(plectra: Mapping[str, Plectrum], columns: Sequence[Column], context: BuildContext) -> Part:
    stiffness, damping, release = columns
    links = Links(ends_of(plectra, context), stiffness, damping)
    side = np.zeros(len(plectra), context.real)
    return Part(Plectra(links, release, side), add_forces=add_forces, memory=Memory(tuple(plectra), (side,)))


PLECTRUM = PartType(
    all_of(Plectrum),
    _build,
    name="plectra",
    compiled_as="gathered through unsigned indices; a grip each",
)
