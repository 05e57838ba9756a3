"""Which of a scene's links act, and which of them its scheme asks for their force between two samples.

Those are inside; the others pull from outside: their force is that of the sample, held until the next. Inside are those
that the scheme says (`theory.schemes`), of those that the network does not say to be ``outside``; under CORDIS's scheme
none.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hapsim.theory.arrays import Bools
from hapsim.theory.interface import DamperModel
from hapsim.theory.network.network import BACKWARD, Network
from hapsim.theory.network.triplets import Indices
from hapsim.theory.schemes import SCHEMES, LinkNature


def is_centred(network: Network) -> bool:
    """Whether the masses move by CORDIS's scheme, or there is none."""
    return SCHEMES[network.scheme].advance is None or network.point_mass.size == 0


def acting_links(network: Network) -> Indices:
    """The links that join two different points, or a point and a ground."""
    return np.flatnonzero(network.ends[:, 0] != network.ends[:, 1])


def inner_links(network: Network) -> Indices:
    """The links that act and that the scheme asks between two samples; of CORDIS's scheme none."""
    advance = SCHEMES[network.scheme].advance
    if advance is None or is_centred(network):
        return np.zeros(0, np.intp)
    links = np.setdiff1d(acting_links(network), np.flatnonzero(network.outside))
    at_channel = touches_channel(network, links)
    asked = zip(links.tolist(), at_channel.tolist(), strict=True)
    natures = (_nature(network.damper[link], at) for link, at in asked)
    return links[np.fromiter(map(advance.inside, natures), bool, links.size)]


def outside_links(network: Network) -> Indices:
    """The links that act, and whose force is that of the sample."""
    return np.setdiff1d(acting_links(network), inner_links(network))


def touches_channel(network: Network, links: Indices) -> Bools:
    """(n,) which of these links end at a channel."""
    ends = network.ends[links]
    return np.any((ends >= 0) & (ends < network.channel_mass.size), axis=1)


@lru_cache(64)
def _nature(damper: DamperModel, at_channel: bool) -> LinkNature:
    return LinkNature(damper == BACKWARD, remembers_nothing(damper), at_channel)


def remembers_nothing(damper: DamperModel) -> bool:
    """Whether its velocity is one of the newest two positions, or sensed."""
    return len(damper.of_positions) <= 2 and not damper.of_velocities
