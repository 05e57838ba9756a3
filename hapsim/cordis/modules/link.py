"""What links have in common: two ends each, which they pull towards each other.

    F[n] = K d[n] + (B / T) g[n]      d: first end minus second end; g: by how much d grows in a sample period

is the visco-elastic link (Florens et al., §6, Figure 5b). Of every link F is the *tension*: where it is positive it
pulls the ends together, so that it acts on the first end as -F, and on the second as +F. That is done here, in
`pull_ends`, for every link there is.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Column


class Ends(NamedTuple):
    """The points that L links join, by number, shape (L,)."""

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]


class Links(NamedTuple):
    """L visco-elastic links: K in N/m, B/T in N/m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column


def ends_of(links: Mapping[str, Any], context: BuildContext) -> Ends:
    """The ends of these modules of a scene."""
    numbers = [[context.number[end] for end in link.between] for link in links.values()]
    first, second = np.array(numbers, np.uint32).reshape(-1, 2).T
    return Ends(np.ascontiguousarray(first), np.ascontiguousarray(second))


@inlined
def count(ends):
    """How many links there are."""
    return np.uint64(ends.first.size)


@inlined
def stretch(ends, i, position):
    """Link i's first end minus its second, where the points are at `position`, in m."""
    return position[ends.first[i]] - position[ends.second[i]]


@inlined
def pull_ends(ends, i, tension, force):
    """Pulls link i's ends towards each other by `tension` N."""
    force[ends.first[i]] -= tension
    force[ends.second[i]] += tension


@inlined
def pull_link(links, i, d, growth, force):
    """Adds link i's force: stretched by `d`, by `growth` more than a sample before, in m."""
    pull_ends(links.ends, i, links.stiffness[i] * d + links.damping_per_sample[i] * growth, force)
