"""The sensed damper: g[n] = T v[n], where v is the velocity that the device measures.

A link's end that is no device point has no sensor: there g is the backward difference.
"""

from __future__ import annotations

from typing import NamedTuple

from hapsim.compiled import inlined
from hapsim.cordis.viscoelastic import Links, pull, stretch


class SensedLinks(NamedTuple):
    """L links; `period`: T in s."""

    links: Links
    period: float


def sensed_links(links: Links, rate: float) -> SensedLinks:
    """Links whose device ends are driven by a sensor. `rate` in Hz."""
    return SensedLinks(links, 1.0 / rate)


@inlined
def _way(point, devices, period, velocity, position, previous):
    """How far a point moves in a sample period, by its sensor where it has one. Device points come first."""
    if point < devices.channel.size:
        return period * velocity[devices.channel[point]]
    return position[point] - previous[point]


@inlined
def pull_sensed(group, devices, velocity, position, previous, force):
    """Adds the force of every link. `velocity`: sensed, in m/s, one per channel."""
    if group is None:
        return
    links = group.links
    for i in range(links.first.size):
        first = _way(links.first[i], devices, group.period, velocity, position, previous)
        second = _way(links.second[i], devices, group.period, velocity, position, previous)
        pull(links, i, stretch(links, i, position), first - second, force)
