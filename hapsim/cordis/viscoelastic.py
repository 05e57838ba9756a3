"""The visco-elastic link: first-order (backward) Euler damper (Florens et al., §6, Figure 5b).

    F[n] = -K d[n] - (B / T) (d[n] - d[n-1])      d: first end minus second end

F acts on the first end, -F on the second.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import jit


class ViscoElasticLinks(NamedTuple):
    """L links: the points they join (uint32), K in N/m, B/T in N/m; arrays of shape (L,)."""

    first: NDArray[np.uint32]
    second: NDArray[np.uint32]
    stiffness: NDArray[np.float64]
    damping_per_sample: NDArray[np.float64]


def viscoelastic_links(
    ends: Sequence[tuple[int, int]], stiffness: Sequence[float], damping: Sequence[float], rate: float
) -> ViscoElasticLinks:
    """Links between numbered points; `stiffness` in N/m, `damping` in N·s/m, `rate` in Hz."""
    pairs = np.array(ends, np.uint32).reshape(-1, 2)
    with np.errstate(over="ignore"):  # the guard sees what comes of an infinity
        damping_per_sample = np.array(damping, np.float64) * rate
    return ViscoElasticLinks(
        np.ascontiguousarray(pairs[:, 0]),
        np.ascontiguousarray(pairs[:, 1]),
        np.array(stiffness, np.float64),
        damping_per_sample,
    )


@jit
def pull(links, position, previous, force):
    """Adds every link's force to the points it joins."""
    for i in range(links.first.size):
        a = links.first[i]
        b = links.second[i]
        stretch = position[a] - position[b]
        growth = stretch - (previous[a] - previous[b])
        f = links.stiffness[i] * stretch + links.damping_per_sample[i] * growth
        force[a] -= f
        force[b] += f
