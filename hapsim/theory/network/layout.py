"""Where a state keeps what: positions, velocities, forces on their way, and what dampers remember.

The state is, in metres and in this order: the points' positions x[n] and x[n-1] (C + M each), the channels' velocities
times T (C), with averaged sampling the channels' true positions (C) and the mean velocities of those that a link
senses, with substeps the velocities that such a channel read a sample ago, the forces computed for the channels, newest
first and times T²/m, that a later sample still needs (C each), and what the links' dampers remember: stretches y[n-2]
and older, velocities v[n-1] and older. Nothing else is kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Indices
from hapsim.theory.interface import SAMPLINGS, DamperModel
from hapsim.theory.network.device_step import DeviceStep
from hapsim.theory.network.network import Network, acting_links


class DamperMemory(NamedTuple):
    """The links (n,) of one damper that damp, and where they remember: (lags, n) slots each."""

    damper: DamperModel
    links: Indices
    stretches: Indices
    velocities: Indices


class StateLayout(NamedTuple):
    """Where the state's parts are. ``held``: (lags, C) slots."""

    now: slice
    before: slice
    velocity: slice
    position: slice
    held: Indices
    size: int
    mean_velocity: Indices  # (C,) slots, -1 where no link senses the channel
    velocity_before: Indices  # the same
    memories: tuple[DamperMemory, ...]

    @property
    def is_averaged(self) -> bool:
        """Whether a channel's reading differs from its position."""
        return self.position.start != self.now.start

    def sensed_slots(self, channels: Indices) -> Indices:
        """Where the velocities are that the device sends, -1 where they are not kept."""
        return self.mean_velocity[channels] if self.is_averaged else self.velocity.start + channels


def damping_links(network: Network) -> dict[DamperModel, Indices]:
    """The links that act and damp, by their damper."""
    acting = acting_links(network)
    groups: dict[DamperModel, list[int]] = {}
    for link in acting[network.damping[acting] != 0.0]:
        groups.setdefault(network.damper[link], []).append(int(link))
    return {damper: np.array(links, dtype=np.intp) for damper, links in groups.items()}


def layout_of(network: Network, steps: list[DeviceStep]) -> StateLayout:
    """Where everything is."""
    channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    averaged = SAMPLINGS[network.sampling].window > 0.0
    groups = damping_links(network)
    velocity = slice(2 * points, 2 * points + channels)
    position = slice(velocity.stop, velocity.stop + channels) if averaged else slice(0, channels)
    size = max(velocity.stop, position.stop)
    some = [network.ends[links] for damper, links in groups.items() if damper.senses]
    ends = np.concatenate([np.zeros((0, 2), np.intp), *some])
    sensed = np.unique(ends[(ends >= 0) & (ends < channels)])
    mean_velocity, velocity_before = np.full((2, channels), -1, dtype=np.intp)
    for slots, is_kept in ((mean_velocity, averaged), (velocity_before, network.substeps > 1)):
        if is_kept:
            slots[sensed] = size + np.arange(sensed.size)
            size += sensed.size
    remembered = steps[0].forces.shape[1] - 1 if steps else 0
    held = size + np.arange(remembered * channels).reshape(remembered, channels)
    size += held.size
    memories = []
    for damper, links in groups.items():
        older, past = max(0, len(damper.of_positions) - 2), len(damper.of_velocities)
        slots = size + np.arange((older + past) * links.size).reshape(older + past, links.size)
        memories.append(DamperMemory(damper, links, slots[:older], slots[older:]))
        size += slots.size
    return StateLayout(
        slice(0, points),
        slice(points, 2 * points),
        velocity,
        position,
        held,
        size,
        mean_velocity,
        velocity_before,
        tuple(memories),
    )
