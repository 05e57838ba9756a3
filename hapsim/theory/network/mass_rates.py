"""What another scheme than CORDIS's makes of the simulated masses, from sample to sample.

A scheme moves M x'' + B x' + K x = f over a sample period: K and B of the links inside (``inner_links``), f that of
the others at the sample. Under rk4 a channel that a link inside touches goes on meanwhile as it went in the last
sample period, and the velocity that it senses stays as it is. The velocity of a mass, times T, is for its links the
step w = T v that the scheme gives it: so the state's "position before" of a mass is x - w.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.network.layout import StateLayout
from hapsim.theory.network.network import Network, inner_links, touches_channel
from hapsim.theory.network.sparse import TripletBuilder, Triplets, dense
from hapsim.theory.schemes import SCHEMES


class MassRates(NamedTuple):
    """What a scheme advances: z = (x, w/unit, u), of M masses the positions x and steps w, m, and what else pulls them.

    ``rates`` (N, N): T times the rates of change of z out of z. ``start`` (N, size): z at the sample out of the state.
    ``now``, ``before`` (M,): where the state has x and x - w. ``size``: N. ``unit``: about the radians that the fastest
    motion turns in a sample period, so that no part of the rates dwarfs the others.
    """

    rates: Triplets
    start: Triplets
    now: Indices
    before: Indices
    size: int
    unit: float

    @property
    def masses(self) -> int:
        """M."""
        return self.now.size


def mass_rates(network: Network, layout: StateLayout, held: Triplets) -> MassRates:
    """What the scheme advances; ``held``: the forces T²/m F on points (C + M) from outside, out of the state."""
    channels, masses = network.channel_mass.size, network.point_mass.size
    now = np.arange(channels, channels + masses)
    before = layout.before.start + now
    held = held.some(held.row >= channels)
    pulled = np.unique(held.row)
    links = inner_links(network)
    asked = channels if touches_channel(network, links).any() else 0
    rates, start = TripletBuilder(), TripletBuilder()
    own, steps = np.arange(masses), masses + np.arange(masses)
    unit = _add_links(network, links, rates, asked)
    rates.add(own, steps, unit)
    start.add(own, now, 1.0)
    start.add_difference(steps, now, before, 1.0 / unit)
    if asked:
        _add_channels(layout, rates, start, 2 * masses, asked)
    first = 2 * masses + 3 * asked
    rates.add(masses + pulled - channels, first + np.arange(pulled.size), 1.0 / unit)
    start.add(first + np.searchsorted(pulled, held.row), held.column, held.value)
    return MassRates(rates.joined(), start.joined(), now, before, first + pulled.size, unit)


def _add_channels(layout: StateLayout, rates: TripletBuilder, start: TripletBuilder, first: int, channels: int) -> None:
    """Each channel's position, its way in a sample period, and the velocity that it senses."""
    own = np.arange(channels)
    position, way, sensed = first + own, first + channels + own, first + 2 * channels + own
    rates.add(position, way, 1.0)
    start.add(position, own, 1.0)
    start.add_difference(way, own, layout.before.start + own)
    slot = layout.sensed_slots(own)
    start.add(sensed[slot >= 0], slot[slot >= 0], 1.0)


def _add_links(network: Network, links: Indices, rates: TripletBuilder, asked: int) -> float:
    """What these links do to the masses' steps; returns the unit of these."""
    masses, channels = network.point_mass.size, network.channel_mass.size
    ends = network.ends[links]
    senses = np.array([network.damper[link].senses for link in links.tolist()], dtype=bool)
    free = [ends[:, end] >= channels for end in (0, 1)]
    own = [ends[free[end], end] - channels for end in (0, 1)]
    stiffness, damping = (
        [value[links[free[end]]] / (network.point_mass[own[end]] * network.rate) for end in (0, 1)]
        for value in (network.stiffness / network.rate, network.damping)
    )
    pace = np.bincount(np.concatenate(own), np.abs(np.concatenate(stiffness)) * 2.0, masses)
    unit = max(1.0, math.sqrt(pace.max(initial=0.0)))
    for end, sign in ((0, 1.0), (1, -1.0)):
        row = masses + own[end]
        for other, direction in ((0, -sign), (1, sign)):
            point, sensed = ends[free[end], other], senses[free[end]]
            met, mass = point >= 0, point - channels
            position = np.where(mass >= 0, mass, 2 * masses + point)
            step = np.where(mass >= 0, masses + mass, 2 * masses + asked + point + np.where(sensed, asked, 0))
            of_step = damping[end] / np.where(mass >= 0, 1.0, unit)
            rates.add(row[met], position[met], direction * stiffness[end][met] / unit)
            rates.add(row[met], step[met], direction * of_step[met])
    return unit


def advanced(network: Network, system: MassRates, size: int) -> tuple[Floats, Floats]:
    """The rows (M, size) of the masses' positions at the next sample and of their x - w there, out of the state."""
    scheme = SCHEMES[network.scheme]
    assert scheme is not None
    rates = dense(system.rates, (system.size, system.size))
    if not np.isfinite(rates).all():
        nothing = np.full((system.masses, size), np.nan)
        return nothing, nothing
    after = scheme.advance(rates, dense(system.start, (system.size, size)))
    return after[: system.masses], after[: system.masses] - system.unit * after[system.masses : 2 * system.masses]
