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
    """The points that L links join, by number: uint32, shape (L,); None: they are the program's first two points, and
    the only link joins them."""

    first: NDArray[np.uint32] | None
    second: NDArray[np.uint32] | None
    several: int | None
    """L; None where there is one link, so that its tick is compiled without a loop."""
    anchored: bool | None
    """True where there is one link and its second end is a ground, which feels nothing; else None."""


class Links(NamedTuple):
    """L visco-elastic links: K in N/m, B/T in N/m; shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column


def ends_of(links: Sequence[Any], frame: Frame, *, alike: bool = False) -> Ends:
    """The ends of these modules of a scene; `alike`: it makes no difference which of two is the first."""
    if frame.hand_on_ground:
        return Ends(None, None, None, True)
    first, second = frame.ends([link.between for link in links])
    if len(links) > 1:
        return Ends(first, second, len(links), None)
    if alike and first[0] in frame.grounds:
        first, second = second, first
    return Ends(first, second, None, True if second[0] in frame.grounds else None)


@inlined
def count(ends):
    """How many links there are."""
    return _count(ends.several)


@inlined
def _count(several):
    return np.uint64(1) if several is None else np.uint64(several)


@inlined
def first_end(ends, i):
    """The number of the point that link i joins to another."""
    return _number(ends.first, i, np.uint64(0))


@inlined
def second_end(ends, i):
    """The number of the other."""
    return _number(ends.second, i, np.uint64(1))


@inlined
def _number(numbers, i, alone):
    return alone if numbers is None else np.uint64(numbers[i])


@inlined
def stretch(ends, i, position):
    """Link i's first end minus its second, where the points are at `position`, in m."""
    return position[first_end(ends, i)] - position[second_end(ends, i)]


@inlined
def pull_ends(ends, i, tension, force):
    """Pulls link i's ends towards each other by `tension` N."""
    force[first_end(ends, i)] -= tension
    _pull_second(ends.anchored, ends, i, tension, force)


@inlined
def _pull_second(anchored, ends, i, tension, force):
    if anchored is None:
        force[second_end(ends, i)] += tension
