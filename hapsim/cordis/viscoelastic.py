"""The visco-elastic link (Florens et al., §6, Figure 5b): a spring and a damper between two points.

    F[n] = -K d[n] - (B / T) g[n]      d: first end minus second end; g: by how much d grows in a sample period

F acts on the first end, -F on the second. What g is, the damper says: `damper_backward.py` and its kin, one a file,
each the recurrence of the transfer function that stands under the same name in `hapsim.theory`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined


class Links(NamedTuple):
    """L links: the points they join (uint32), K in N/m, B/T in N/m; arrays of shape (L,)."""

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    stiffness: NDArray[np.float64]
    damping_per_sample: NDArray[np.float64]


def links_between(
    ends: Sequence[tuple[int, int]], stiffness: NDArray[np.float64], damping_per_sample: NDArray[np.float64]
) -> Links:
    """Links between numbered points; the two arrays, N/m both, are kept, not copied."""
    pairs = np.array(ends, np.uint32).reshape(-1, 2)
    return Links(np.ascontiguousarray(pairs[:, 0]), np.ascontiguousarray(pairs[:, 1]), stiffness, damping_per_sample)


@inlined
def stretch(links, i, position):
    """Link i's first end minus its second, where the points are at `position`, in m."""
    return position[links.first[i]] - position[links.second[i]]


@inlined
def pull(links, i, d, growth, force):
    """Adds link i's force to the points it joins: stretched by `d`, by `growth` more than a sample before, in m."""
    f = links.stiffness[i] * d + links.damping_per_sample[i] * growth
    force[links.first[i]] -= f
    force[links.second[i]] += f
