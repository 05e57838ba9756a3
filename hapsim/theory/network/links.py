"""Which of a scene's links act, and which of them its scheme asks for their force between two samples.

Those are inside; the others pull from outside: their force is that of the sample, held until the next. Inside are

    midpoint, exact     links with a backward damper that touch no channel
    rk4                 links with a damper that remembers nothing

of those that the network does not say to be ``outside``; under CORDIS's scheme none.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Bools
from hapsim.theory.interface import DamperModel
from hapsim.theory.network.network import BACKWARD, Network
from hapsim.theory.network.triplets import Indices
from hapsim.theory.schemes import SCHEMES


def is_centred(network: Network) -> bool:
    """Whether the masses move by CORDIS's scheme, or there is none."""
    return SCHEMES[network.scheme].advance is None or network.point_mass.size == 0


def acting_links(network: Network) -> Indices:
    """The links that join two different points, or a point and a ground."""
    return np.flatnonzero(network.ends[:, 0] != network.ends[:, 1])


def inner_links(network: Network) -> Indices:
    """The links that act and that the scheme asks between two samples; of CORDIS's scheme none."""
    if is_centred(network):
        return np.zeros(0, np.intp)
    never = set(np.flatnonzero(network.outside).tolist())
    links = [link for link in acting_links(network).tolist() if link not in never and _is_inside(network, link)]
    return np.array(links, np.intp)


def outside_links(network: Network) -> Indices:
    """The links that act, and whose force is that of the sample."""
    return np.setdiff1d(acting_links(network), inner_links(network))


def touches_channel(network: Network, links: Indices) -> Bools:
    """(n,) which of these links end at a channel."""
    ends = network.ends[links]
    return np.any((ends >= 0) & (ends < network.channel_mass.size), axis=1)


def _is_inside(network: Network, link: int) -> bool:
    damper = network.damper[link]
    if network.scheme == "rk4":
        return _remembers_nothing(damper)
    return damper == BACKWARD and not touches_channel(network, np.array([link]))[0]


def _remembers_nothing(damper: DamperModel) -> bool:
    return len(damper.of_positions) <= 2 and not damper.of_velocities
