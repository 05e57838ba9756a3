"""The free motions of a scene: its parts that no spring ties to anything that stays where it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hapsim.theory.arrays import Bools

if TYPE_CHECKING:
    from hapsim.theory.network.network import Network


def poles_at_rest(network: Network) -> int:
    """How many poles are 1 by the structure of the scene alone.

    A part that no spring ties rests wherever it is: one pole. Where no damper brakes it either it goes on as it goes:
    a second.
    """
    springs = network.stiffness != 0.0
    brakes = springs | (network.damping != 0.0)
    tied = network.channel_stiffness > 0.0
    braked = tied | (network.channel_friction > 0.0)
    return _free_parts(network, springs, tied) + _free_parts(network, brakes, braked)


def _free_parts(network: Network, links: Bools, held: Bools) -> int:
    """How many parts, joined by these links, neither reach a ground nor one of the channels that are held."""
    points = network.channel_mass.size + network.point_mass.size
    parent = list(range(points + 1))  # the last is what stays where it is

    def part(point: int) -> int:
        while parent[point] != point:
            parent[point] = parent[parent[point]]
            point = parent[point]
        return point

    for a, b in network.ends[links].tolist():
        parent[part(a % (points + 1))] = part(b % (points + 1))  # a ground, -1, is the last
    for channel in np.flatnonzero(held).tolist():
        parent[part(channel)] = part(points)
    return len({part(point) for point in range(points + 1)}) - 1
