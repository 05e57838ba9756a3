"""Rigid motions of a scene: those that cause no elastic force.

With M the masses, B the dampings and K the stiffnesses, a motion n with K n = 0 rests at any amplitude: one pole at 1.
Without a brake, n' B n = 0, it continues at constant velocity: a second pole at 1. With positive masses there is no
third. The device's delay has no effect, since there is no force.

If all stiffnesses are positive, each part without a ground and without a held channel has one such motion, its
translation. A spring of negative stiffness, as in bending, allows others, such as the tilt of a free bar; in parts with
such springs they are counted.

A long bar's slowest bending is softer than its stiffness by the fourth power of its length, so no tolerance separates
it from a rigid motion. The count is therefore exact: each floating-point number, an integer times a power of two, is
represented exactly in the integers modulo a prime. `scipy.linalg.null_space` finds 18 poles in place of 4 for a free
bar of 100 masses whose stiffnesses span twelve decades.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from functools import cache

import numpy as np

from hapsim.theory.arrays import Bools, Floats, Indices
from hapsim.theory.network.felt import free_motions
from hapsim.theory.network.network import Network, part_of_each

MOST_WORK = 10_000_000  # multiplications for a part of the scene: some seconds
PRIME = 10**18 + 9
Row = dict[int, int]  # column: element, without zeros


class TooMuchWorkError(Exception):
    """Raised if the elimination takes more than MOST_WORK multiplications."""


def poles_at_rest(network: Network) -> int:
    """Number of poles that are 1 by the structure of the scene alone."""
    return sum(motions_at_rest(network))


def motions_at_rest(network: Network) -> tuple[int, int]:
    """Numbers of motions that rest at any amplitude, and of those among them that continue at constant velocity."""
    if network.rows is not None or network.second is not None:
        drifts = free_motions(network)[1]
        unbraked = int(drifts.any(axis=0).sum())
        return drifts.shape[1] - unbraked, unbraked
    springs = network.stiffness != 0.0
    brakes = springs | (network.damping != 0.0)
    tied = _at_points(network, network.channel_stiffness) > 0.0
    braked = tied | (_at_points(network, network.channel_friction) > 0.0)
    negative = (network.stiffness < 0.0) | (network.damping < 0.0)
    rests = unbraked = 0
    if negative.any():
        for points, links in _parts_with(network, negative, brakes):
            try:
                rigid, rank = _counted(network, points, links)
                rests, unbraked = rests + rigid, unbraked + rigid - rank
            except TooMuchWorkError:  # then at least the translation
                continue
            tied[points] = braked[points] = True
    return rests + _free_parts(network, springs, tied), unbraked + _free_parts(network, brakes, braked)


def _at_points(network: Network, of_channels: Floats) -> Floats:
    """Values of all points, (C + M,): the channels' own, and 0 for the masses."""
    return np.concatenate([of_channels, np.zeros(network.point_mass.size)])


def _free_parts(network: Network, links: Bools, held: Bools) -> int:
    """Number of parts, joined by these links, that reach neither a ground nor a held point."""
    part = part_of_each(network.ends[links], held.size)
    ends = network.ends[links]
    grounded = ends[(ends == -1).any(axis=1)].max(axis=1, initial=-1)
    stays = np.concatenate([part[held], part[grounded[grounded >= 0]]])
    return np.setdiff1d(part, stays).size


def _parts_with(network: Network, some: Bools, links: Bools) -> list[tuple[Indices, Indices]]:
    """Points and links of each part, joined by ``links``, that contains one of ``some``."""
    part = part_of_each(network.ends[links], network.channel_mass.size + network.point_mass.size)
    acting = np.flatnonzero(links & (network.ends[:, 0] != network.ends[:, 1]))
    own = part[network.ends[acting].max(axis=1)]
    return [(np.flatnonzero(part == number), acting[own == number]) for number in np.unique(own[some[acting]])]


def _counted(network: Network, points: Indices, links: Indices) -> tuple[int, int]:
    """Dimension of K's null space of one part, and of its braked subspace."""
    place = {point: i for i, point in enumerate(points.tolist())}
    ends = [[place.get(end, -1) for end in pair] for pair in network.ends[links].tolist()]
    stiffness = _matrix(ends, network.stiffness[links], _at_points(network, network.channel_stiffness)[points])
    damping = _matrix(ends, network.damping[links], _at_points(network, network.channel_friction)[points])
    rigid = null_space(stiffness, points.size)
    braked = [[sum(v * motion[i] for i, v in row.items()) % PRIME for row in damping] for motion in rigid]
    form = [[sum(a * f for a, f in zip(motion, force, strict=True)) % PRIME for force in braked] for motion in rigid]
    return len(rigid), len(_echelon({i: value for i, value in enumerate(row) if value} for row in form))


def _matrix(ends: list[list[int]], of_links: Floats, of_points: Floats) -> list[Row]:
    """Rows of the sum k e e' over the links, e their two ends, with the points' own values on the diagonal."""
    exact = cache(residue)
    rows: list[Row] = [defaultdict(int, {i: exact(own)} if own else {}) for i, own in enumerate(of_points.tolist())]
    for pair, value in zip(ends, of_links.tolist(), strict=True):
        for a, b in (pair, pair[::-1]):
            if a >= 0:
                rows[a][a] += exact(value)
                if b >= 0:
                    rows[a][b] -= exact(value)
    return [{column: value % PRIME for column, value in row.items() if value % PRIME} for row in rows]


def residue(value: float) -> int:
    """Returns a finite number modulo the prime, exactly."""
    numerator, power_of_two = value.as_integer_ratio()
    return numerator * pow(power_of_two, -1, PRIME) % PRIME


def null_space(rows: Iterable[Row], columns: int) -> list[list[int]]:
    """Returns a basis of the vectors (columns,), modulo the prime, that all rows map to zero.

    Raises:
        TooMuchWorkError: after ``MOST_WORK`` multiplications.
    """
    echelon = _echelon(rows)
    basis = []
    for free in (column for column in range(columns) if column not in echelon):
        vector = [0] * columns
        vector[free] = 1
        for first in sorted(echelon, reverse=True):
            vector[first] = -sum(value * vector[column] for column, value in echelon[first].items()) % PRIME
        basis.append(vector)
    return basis


def _echelon(rows: Iterable[Row]) -> dict[int, Row]:
    """Returns rows that span the same space, by their first columns, where each has a one."""
    echelon: dict[int, Row] = {}
    work = 0
    for given in rows:
        row = dict(given)
        while row and (first := min(row)) in echelon:
            work += len(row) + len(echelon[first])
            if work > MOST_WORK:
                raise TooMuchWorkError
            factor = row[first]
            for column, value in echelon[first].items():
                row[column] = (row.get(column, 0) - factor * value) % PRIME
                if not row[column]:
                    del row[column]
        if row:
            inverse = pow(row[first], -1, PRIME)
            echelon[first] = {column: value * inverse % PRIME for column, value in row.items()}
    return echelon
