"""What links have in common: two ends each, which they pull towards each other.

    F[n] = -K d[n] - (B / T) g[n]      d: first end minus second end; g: by how much d grows in a sample period

is the visco-elastic link (Florens et al., §6, Figure 5b). F acts on the first end, -F on the second. What g is, the
damper says: `damper_backward.py` and its kin, one a file, each the recurrence of the transfer function that stands
under the same name in `hapsim.theory`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.cordis.kind import Column, Frame


class Ends(NamedTuple):
    """The points that L links join, by number: uint32, shape (L,)."""

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]


class Links(NamedTuple):
    """L visco-elastic links: K in N/m, B/T in N/m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column


def ends_of(links: Sequence[Any], frame: Frame) -> Ends:
    """The ends of these modules of a scene."""
    return Ends(*frame.ends([link.between for link in links]))


@inlined
def stretch(ends, i, position):
    """Link i's first end minus its second, where the points are at `position`, in m."""
    return position[ends.first[i]] - position[ends.second[i]]


@inlined
def pull_ends(ends, i, tension, force):
    """Pulls link i's ends towards each other by `tension` N."""
    force[ends.first[i]] -= tension
    force[ends.second[i]] += tension
