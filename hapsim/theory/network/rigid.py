"""The rigid motions of a scene: those that stretch, or bend, nothing that would pull back.

Where z = 1 + s T with s small, a motion x e^(s t) of the points meets M s² + B s + K: M the masses, B the sums of the
links' dampings and the channels' frictions, K those of the springs. A motion n with K n = 0 rests wherever it is: one
pole at 1. Where nothing brakes it either, n' B n = 0, it goes on as it goes: a second, and with positive masses there
is no third. (That the device is late changes nothing of it: there is no force to be late.)

Of springs that only pull together, a part that neither ground nor held channel is tied to has one such motion, all of
it alike. A spring of negative stiffness, of which bending consists, allows others, the tilt of a free bar, its turning
about a hinge; in the parts of a scene where there is one they are counted as they come.
"""

from __future__ import annotations

from collections import defaultdict
from functools import cache

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.network.exact_null_space import PRIME, Row, TooMuchWorkError, null_space, rank, residue
from hapsim.theory.network.network import Network
from hapsim.theory.network.parts import part_of_each

Indices = NDArray[np.intp]

MOST_WORK = 10_000_000  # multiplications for a part of the scene: some seconds


def poles_at_rest(network: Network) -> int:
    """How many poles are 1 by the structure of the scene alone."""
    springs = network.stiffness != 0.0
    brakes = springs | (network.damping != 0.0)
    tied = _at_points(network, network.channel_stiffness) > 0.0
    braked = tied | (_at_points(network, network.channel_friction) > 0.0)
    negative = (network.stiffness < 0.0) | (network.damping < 0.0)
    count = 0
    if negative.any():
        for points, links in _parts_with(network, negative, brakes):
            try:
                count += _counted(network, points, links)
            except TooMuchWorkError:  # then at least what moves alike
                continue
            tied[points] = braked[points] = True
    return count + _free_parts(network, springs, tied) + _free_parts(network, brakes, braked)


def _at_points(network: Network, of_channels: Floats) -> Floats:
    """(C + M,): the channels' own, and 0 for the masses."""
    return np.concatenate([of_channels, np.zeros(network.point_mass.size)])


def _free_parts(network: Network, links: Bools, held: Bools) -> int:
    """How many parts, joined by these links, neither reach a ground nor one of the points that are held."""
    part = part_of_each(network.ends[links], held.size)
    ends = network.ends[links]
    grounded = ends[(ends == -1).any(axis=1)].max(axis=1, initial=-1)
    stays = np.concatenate([part[held], part[grounded[grounded >= 0]]])
    return np.setdiff1d(part, stays).size


def _parts_with(network: Network, some: Bools, links: Bools) -> list[tuple[Indices, Indices]]:
    """The points and the links of each part, joined by these links, in which there is one of some."""
    part = part_of_each(network.ends[links], network.channel_mass.size + network.point_mass.size)
    acting = np.flatnonzero(links & (network.ends[:, 0] != network.ends[:, 1]))
    own = part[network.ends[acting].max(axis=1)]
    wanted = np.unique(own[some[acting]])
    return [(np.flatnonzero(part == number), acting[own == number]) for number in wanted]


def _counted(network: Network, points: Indices, links: Indices) -> int:
    """The poles at 1 of one part: the dimension of K's null space, and of what no damper brakes in it."""
    place = {point: i for i, point in enumerate(points.tolist())}
    ends = [[place.get(end, -1) for end in pair] for pair in network.ends[links].tolist()]
    stiffness = _matrix(ends, network.stiffness[links], _at_points(network, network.channel_stiffness)[points])
    damping = _matrix(ends, network.damping[links], _at_points(network, network.channel_friction)[points])
    rigid = null_space(stiffness, points.size, MOST_WORK)
    braked = [_times(damping, motion) for motion in rigid]
    form = [[sum(a * f for a, f in zip(motion, force, strict=True)) % PRIME for force in braked] for motion in rigid]
    return 2 * len(rigid) - rank(form, MOST_WORK)


def _matrix(ends: list[list[int]], of_links: Floats, of_points: Floats) -> list[Row]:
    """The rows of sum k e e' over the links, e their two ends, and of the points' own on the diagonal."""
    exact = cache(residue)
    rows: list[Row] = [defaultdict(int, {i: exact(own)} if own else {}) for i, own in enumerate(of_points.tolist())]
    for pair, value in zip(ends, of_links.tolist(), strict=True):
        for a, b in (pair, pair[::-1]):
            if a >= 0:
                rows[a][a] += exact(value)
                if b >= 0:
                    rows[a][b] -= exact(value)
    return [{column: value % PRIME for column, value in row.items() if value % PRIME} for row in rows]


def _times(matrix: list[Row], vector: list[int]) -> list[int]:
    return [sum(value * vector[column] for column, value in row.items()) % PRIME for row in matrix]
