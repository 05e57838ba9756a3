"""What another scheme than CORDIS's makes of the simulated masses, from sample to sample.

A scheme moves M x'' + B x' + K x = f over a sample period: K and B of the links inside (``inner_links``), f that of
the others at the sample. Under rk4 a channel that a link inside touches goes on meanwhile as it went in the last
sample period, and the velocity that it senses stays as it is. Links feel of a mass, as its velocity times T, the step
w = T v that the scheme gives it: so the state's "position before" of a mass is x - w.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.layout import Layout
from hapsim.theory.network.network import Network, inner_links, touches_channel
from hapsim.theory.network.sparse import Indices, TripletBuilder, Triplets, dense
from hapsim.theory.schemes import SCHEMES


class MassRates(NamedTuple):
    """What a scheme advances: z = (x, w, u), of M masses the positions and steps, m, and what else pulls them.

    ``rates`` (N, N): T times the rates of change of z out of z, by entries. ``start`` (N, size): z at the sample out of
    the state. ``now``, ``before`` (M,): where the state has x and x - w. ``size``: N.
    """

    rates: Triplets
    start: Triplets
    now: Indices
    before: Indices
    size: int

    @property
    def masses(self) -> int:
        return self.now.size


def mass_rates(network: Network, layout: Layout, held: Triplets) -> MassRates:
    """What the scheme advances; ``held``: the forces T²/m F on points (C + M) from outside, out of the state."""
    channels, masses = network.channel_mass.size, network.point_mass.size
    now = np.arange(channels, channels + masses)
    before = layout.before.start + now
    held = held.some(held.row >= channels)
    pulled = np.unique(held.row)
    asked = channels if touches_channel(network, inner_links(network)).any() else 0
    rates, start = TripletBuilder(), TripletBuilder()
    own, steps = np.arange(masses), masses + np.arange(masses)
    rates.add(own, steps, 1.0)
    start.add(own, now, 1.0)
    _add_step(start, steps, now, before)
    _add_links(network, rates, masses, asked)
    if asked:
        _add_channels(layout, rates, start, 2 * masses, asked)
    first = 2 * masses + 3 * asked
    rates.add(masses + pulled - channels, first + np.arange(pulled.size), 1.0)
    start.add(first + np.searchsorted(pulled, held.row), held.column, held.value)
    return MassRates(rates.joined(), start.joined(), now, before, first + pulled.size)


def _add_step(start: TripletBuilder, row: Indices, now: Indices, before: Indices) -> None:
    start.add(row, now, 1.0)
    start.add(row, before, -1.0)


def _add_channels(layout: Layout, rates: TripletBuilder, start: TripletBuilder, first: int, channels: int) -> None:
    """Each channel's position, its way in a sample period, and the velocity that it senses."""
    own = np.arange(channels)
    position, way, sensed = first + own, first + channels + own, first + 2 * channels + own
    rates.add(position, way, 1.0)
    start.add(position, own, 1.0)
    _add_step(start, way, own, layout.before.start + own)
    averaged = layout.position.start != layout.now.start
    slot = layout.mean_velocity if averaged else layout.velocity.start + own
    start.add(sensed[slot >= 0], slot[slot >= 0], 1.0)


def _add_links(network: Network, rates: TripletBuilder, masses: int, asked: int) -> None:
    """What the links that are inside do to the masses' steps."""
    links, channels = inner_links(network), network.channel_mass.size
    ends = network.ends[links]
    senses = np.array([network.damper[link].senses for link in links.tolist()], dtype=bool)
    for end, sign in ((0, 1.0), (1, -1.0)):
        free = ends[:, end] >= channels
        row = masses + ends[free, end] - channels
        mass = network.point_mass[ends[free, end] - channels]
        stiffness = network.stiffness[links[free]] / (mass * network.rate) / network.rate
        damping = network.damping[links[free]] / (mass * network.rate)
        for other, direction in ((0, -sign), (1, sign)):
            point, sensed = ends[free, other], senses[free]
            met = point >= 0
            own = point - channels
            position = np.where(own >= 0, own, 2 * masses + point)
            step = np.where(own >= 0, masses + own, 2 * masses + asked + point + np.where(sensed, asked, 0))
            rates.add(row[met], position[met], direction * stiffness[met])
            rates.add(row[met], step[met], direction * damping[met])


def advanced(network: Network, system: MassRates, size: int) -> tuple[Floats, Floats]:
    """The rows (M, size) of the masses' positions at the next sample and of their x - w there, out of the state."""
    advance = SCHEMES[network.scheme].advance
    assert advance is not None
    masses = system.masses
    rates = dense(system.rates, (system.size, system.size))
    start = dense(system.start, (system.size, size))
    # Steps in units of the fastest motion, so that no part of the rates dwarfs the others.
    pace = np.abs(rates[masses : 2 * masses, :masses]).sum(axis=1).max(initial=0.0)
    unit = max(1.0, float(np.sqrt(pace)))
    if not np.isfinite(rates).all() or not np.isfinite(unit):
        return np.full((masses, size), np.nan), np.full((masses, size), np.nan)
    steps = slice(masses, 2 * masses)
    rates[steps] /= unit
    rates[:, steps] *= unit
    start[steps] /= unit
    after = advance(rates, start)
    return after[:masses], after[:masses] - unit * after[steps]
