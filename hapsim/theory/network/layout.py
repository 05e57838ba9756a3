"""Where a state keeps what: positions, velocities, forces on their way, and what dampers remember."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.interface import SAMPLINGS, DamperModel
from hapsim.theory.network.device_step import DeviceStep
from hapsim.theory.network.network import Network, acting_links
from hapsim.theory.network.sparse import Indices


class Layout(NamedTuple):
    """Where the state's parts are; per link and lag the first slot of what a damper remembers is in ``Memory``."""

    now: slice
    before: slice
    velocity: slice
    position: slice
    held: slice
    size: int
    mean_velocity: Indices  # (C,) slots, -1 where no link senses the channel
    memories: tuple[Memory, ...]


class Memory(NamedTuple):
    """The links (n,) of one damper that damp, and where they remember: (lags, n) slots each."""

    damper: DamperModel
    links: Indices
    stretches: Indices
    velocities: Indices


def damping_links(network: Network) -> dict[DamperModel, Indices]:
    """The links that act and damp, by their damper."""
    acting = acting_links(network)
    groups: dict[DamperModel, list[int]] = {}
    for link in acting[network.damping[acting] != 0.0]:
        groups.setdefault(network.damper[link], []).append(int(link))
    return {damper: np.array(links, dtype=np.intp) for damper, links in groups.items()}


def layout_of(network: Network, steps: list[DeviceStep]) -> Layout:
    """Where everything is."""
    channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    averaged = SAMPLINGS[network.sampling].window > 0.0
    remembered = steps[0].forces.shape[1] - 1 if steps else 0
    groups = damping_links(network)
    velocity = slice(2 * points, 2 * points + channels)
    position = slice(velocity.stop, velocity.stop + channels) if averaged else slice(0, channels)
    size = max(velocity.stop, position.stop)
    mean_velocity = np.full(channels, -1, dtype=np.intp)
    if averaged:
        some = [network.ends[links] for damper, links in groups.items() if damper.senses]
        ends = np.concatenate([np.zeros((0, 2), np.intp), *some])
        sensed = np.unique(ends[(ends >= 0) & (ends < channels)])
        mean_velocity[sensed] = size + np.arange(sensed.size)
        size += sensed.size
    held = slice(size, size + remembered * channels)
    size = held.stop
    memories = []
    for damper, links in groups.items():
        older, past = max(0, len(damper.of_positions) - 2), len(damper.of_velocities)
        slots = size + np.arange((older + past) * links.size).reshape(older + past, links.size)
        memories.append(Memory(damper, links, slots[:older], slots[older:]))
        size += slots.size
    return Layout(
        slice(0, points), slice(points, 2 * points), velocity, position, held, size, mean_velocity, tuple(memories)
    )
