"""The sensed damper: g[n] = T v[n], where v is the velocity that the device measures.

A link's end that is no device point has no sensor: there g is the backward difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.device_point import sensed
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.link import Links, count, first_end, second_end, stretch
from hapsim.cordis.viscoelastic import links_of, live_links, pull_link, with_damper
from hapsim.scene import ViscoElastic


class SensedLinks(NamedTuple):
    """L links; `period`: T in s, shape (1,)."""

    links: Links
    period: Column


def _build(links: Mapping[str, ViscoElastic], columns: Sequence[Column], frame: Frame) -> SensedLinks:
    return SensedLinks(links_of(links, columns, frame), np.array([1.0 / frame.rate], frame.real))


SENSED = Kind(
    with_damper("sensed"),
    _build,
    live_links,
    name="visco-elastic links (sensed damper)",
    compiled_as="gathered through unsigned indices; velocities come from the device",
    forgets=True,
)


@inlined
def _way(point, period, moment):
    """How far a point moves in a sample period, by its sensor where it has one."""
    velocity, has_sensor = sensed(moment.devices, moment.velocity, point)
    if has_sensor:
        return moment.position.dtype.type(period * velocity)
    return moment.position[point] - moment.previous[point]


@pulls(SensedLinks)
@inlined
def pull_sensed(group, moment):
    """Adds the force of every link."""
    ends, period = group.links.ends, group.period[0]
    for i in range(count(ends)):
        growth = _way(first_end(ends, i), period, moment) - _way(second_end(ends, i), period, moment)
        pull_link(group.links, i, stretch(ends, i, moment.position), growth, moment.force)
