"""N steps of the masses in a sample period, as one step of the state (``layout.py``).

When x[n] arrives, the masses move N times by T/N, the hands on the line x[n-1] + (x[n] - x[n-1]) j/N, j = 1 … N, and a
velocity that the device senses on the line between its own two readings. The force of the last step, or the mean of all
N, is that of the sample.

One of these steps is a matrix over the state and, of each channel, what its position and its velocity gain in a step
and the force so far (``Lift``): the hands go on, then everything acts as in a scene that runs at N times the rate. Its
N-th power lies between two others: what embeds the state at the sample, and the device's row.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Indices
from hapsim.theory.network.device_step import DeviceStep
from hapsim.theory.network.layout import StateLayout, layout_of
from hapsim.theory.network.mass_rates import MassRates
from hapsim.theory.network.network import Network
from hapsim.theory.network.sparse import TripletBuilder, Triplets
from hapsim.theory.network.state import channel_steps, device_rows, scene_rows


class Lift(NamedTuple):
    """The parts of the matrix that takes the state at one sample to the state at the next: of the state's size n and,
    with what the steps need besides, N."""

    network: Network
    layout: StateLayout
    device: list[DeviceStep]
    size: int

    @property
    def scene(self) -> Indices:
        """Where the state has the masses and what dampers remember: the steps move these, the sample the others."""
        mass = np.arange(self.network.channel_mass.size, self.layout.now.stop)
        remembered = [slots.ravel() for one in self.layout.memories for slots in (one.stretches, one.velocities)]
        return np.concatenate([mass, self.layout.before.start + mass, *remembered])

    @property
    def asked(self) -> Indices:
        """(C,) where the larger state has the force T²/m F, T the sample period."""
        return self._own[2]

    @property
    def _own(self) -> Indices:
        """(3, C): what the position and the velocity gain in a step, and the force."""
        channels = self.network.channel_mass.size
        return self.layout.size + np.arange(3 * channels).reshape(3, channels)

    @property
    def _sensed(self) -> tuple[Indices, Indices]:
        """The channels whose velocity is sensed, and where the state has it."""
        channels = np.flatnonzero(self.layout.velocity_before >= 0)
        return channels, self.layout.sensed_slots(channels)

    def embedded(self) -> Triplets:
        """(N, n): before the first step the hands are where they were a sample ago."""
        parts, steps = TripletBuilder(), self.network.substeps
        (gain, speeding, _), before = self._own, self.layout.before.start
        own, (sensed, slot) = np.arange(gain.size), self._sensed
        parts.add(self.scene, self.scene, 1.0)
        parts.add(own, before + own, 1.0)
        parts.add_difference(gain, own, before + own, 1.0 / steps)
        older = self.layout.velocity_before[sensed]
        parts.add(slot, older, 1.0 / steps)
        parts.add_difference(speeding[sensed], slot, older, 1.0 / steps**2)
        return parts.joined()

    def moved_hands(self) -> Triplets:
        """(N, N): first in a step, the hands go on."""
        parts, (gain, speeding, _) = TripletBuilder(), self._own
        own, every, (sensed, slot) = np.arange(gain.size), np.arange(self.size), self._sensed
        before = self.layout.before.start + own
        parts.add(before, own, 1.0)
        kept = np.delete(every, before)
        parts.add(kept, kept, 1.0)
        parts.add(own, gain, 1.0)
        parts.add(slot, speeding[sensed], 1.0)
        return parts.joined()

    def stepped(self) -> tuple[Triplets, MassRates | None]:
        """(N, N): then everything acts; as ``transition_parts``."""
        network, parts, (gain, speeding, asked) = self.network, TripletBuilder(), self._own
        fine = replace(network, rate=network.rate * network.substeps, substeps=1)
        force, system = scene_rows(fine, self.layout, parts)
        own, (sensed, slot) = np.arange(gain.size), self._sensed
        for kept in (own, gain, slot, speeding[sensed]):
            parts.add(kept, kept, 1.0)
        on_hand = force.some(force.row < own.size)
        share = network.substeps**2 if network.decimation == "last" else network.substeps  # T², not that of a step
        parts.add(asked[on_hand.row], on_hand.column, share * on_hand.value)
        if network.decimation == "mean":
            parts.add(asked, asked, 1.0)
        return parts.joined(), system

    def of_device(self) -> Triplets:
        """(n, n + C): the channels' rows, from the state and from the forces T²/m F on them."""
        parts, channel = TripletBuilder(), np.arange(len(self.device))
        force = Triplets(channel, self.layout.size + channel, np.ones(channel.size))
        device_rows(self.layout, self.device, force, parts)
        sensed, slot = self._sensed
        parts.add(self.layout.velocity_before[sensed], slot, 1.0)
        return parts.joined()


def lift_of(network: Network) -> Lift:
    """The parts for this network."""
    device = channel_steps(network)
    layout = layout_of(network, device)
    return Lift(network, layout, device, layout.size + 3 * network.channel_mass.size)
