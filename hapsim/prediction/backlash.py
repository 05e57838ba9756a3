"""Backlash of a transmission: its two states, in mesh and free, and the oscillation between them.

In mesh, the loop is that of the transmission without play; free, the motor moves alone, or the loop sees a handle that
it does not move, where no motion grows. The oscillation is simulated: the loop of `theory` in mesh, and what the play
changes in the belt's force, in steps within the sample.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import islice
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm

from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.device_step import motions_within
from hapsim.theory.network import loop
from hapsim.theory.plant import LEAD, LEAD_RATE, Drive, Plant
from hapsim.theory.rows import cut
from hapsim.theory.sample import mobility, normalised_channels, sizes_of

_ANGLE = 0.1  # rad, turn of the belt's own swing in a step
_STEPS = 12, 200  # in a sample, the fewest and the most
_BLOCK, _MOST_BLOCKS = 500, 8  # samples, of which two in turn are compared
_KICKS = 0.3, 0.6, 1.0, 2.0, 3.0, 6.0, 10.0  # of the backlash
_STEADY = 1.05  # ratio of a swing to that of the block before
_SMALL = 0.02  # of the backlash: a smaller swing of motor or handle dies out, or is not felt


class Rattle(NamedTuple):
    """Steady oscillation in the play, from end to end, of a kick that leads to the widest."""

    motor: float
    """m."""
    handle: float
    """m."""


class _Belt(NamedTuple):
    """Belt with play, in the units of its plant."""

    stiffness: float
    damping: float
    half: float
    """Half of the backlash, m."""

    def lacks(self, lead: Floats, rate: Floats) -> Floats:
        """Pull of the teeth less that of the belt without play; teeth never pull each other back."""
        side = np.sign(lead)
        pressing = self.stiffness * (np.abs(lead) - self.half) + self.damping * side * rate
        pull = np.where(np.abs(lead) > self.half, side * np.maximum(pressing, 0.0), 0.0)
        return pull - self.stiffness * lead - self.damping * rate


def free_network(network: Network, channel: int) -> Network | None:
    """Returns the network with the motor of a channel alone, in its play; None if the loop does not see the motor."""
    drive, one = network.drives[channel], np.arange(network.channel_mass.size) == channel
    if drive.reads_handle:
        return None
    drives = [Drive(lag=drive.lag) if number == channel else other for number, other in enumerate(network.drives)]
    return replace(
        network,
        channel_mass=np.where(one, drive.motor_mass, network.channel_mass),
        channel_friction=np.where(one & drive.brakes_handle, 0.0, network.channel_friction),
        channel_stiffness=np.where(one, 0.0, network.channel_stiffness),
        drives=drives,
    )


@np.errstate(all="ignore")
def rattle_in(network: Network, backlash: float) -> Rattle | None:
    """Returns the widest steady oscillation of a part (one hand, linear links, stable in mesh) in its play (m) that
    kicks of up to ten times the play lead to while no push closes it. None if every one dies out, grows without end or
    is not steady, or if the belt is too fast to simulate."""
    ((friction, spring, drive),) = normalised_channels(network)
    plant = drive.plant(friction, spring)
    free = drive._replace(stiffness=0.0, damping=0.0).plant(friction, spring)
    pair = (plant.rates - free.rates)[:, LEAD] / drive.stiffness  # what a pull on the lead moves
    count = max(_STEPS[0], math.ceil(math.sqrt(abs(pair[LEAD_RATE]) * drive.stiffness) / _ANGLE))
    if count > _STEPS[1]:
        return None
    belt = _Belt(drive.stiffness, drive.damping, 0.5 * backlash)
    before = np.zeros((2, len(_KICKS)))
    for after in islice(_swings(network, plant, pair, belt, count), _MOST_BLOCKS):
        is_small = (after < _SMALL * backlash).any(axis=0)
        steady = ((after < _STEADY * before) & (before < _STEADY * after)).all(axis=0) & ~is_small
        if not np.isfinite(after).all() or (steady | is_small).all():
            break
        before = after
    if not np.isfinite(after).all() or not steady.any():
        return None
    return Rattle(*after[:, np.where(steady, after.max(axis=0), 0.0).argmax()].tolist())


def _swings(network: Network, plant: Plant, pair: Floats, belt: _Belt, count: int) -> Iterator[Floats]:
    """Yields the swing of motor and handle in each block, m from end to end, (2, kicks)."""
    size, (change, _, _, force, *_) = len(plant.rates), loop(network, inputs=True)
    parts, one = cut(np.arange(len(change)), sizes_of(network)), np.eye(len(change))
    own = np.concatenate([parts[name] for name in ("position", "velocity", "inner")])
    acting = mobility(network) / network.rate**2 * force
    inputs = np.vstack([one[own], acting, one[parts["held"]]])
    within = motions_within(plant, network.delay, network.hold, 2 * count)[:-1]
    begins = np.array([one[own], *(one[own] + moved @ inputs[: moved.shape[1]] for moved in within)])
    leads, rates = begins[:, LEAD], begins[:, LEAD_RATE]
    rest = np.block([[plant.rates, pair[:, None]], [np.zeros((1, size + 1))]])
    (half, pushed_half), (whole, pushed) = (np.hsplit(expm(rest * h)[:size], [size]) for h in (0.5 / count, 1 / count))
    half, pushed_half = half[LEAD : LEAD_RATE + 1], pushed_half[LEAD : LEAD_RATE + 1]
    state = np.zeros((len(change), len(_KICKS)))
    state[own[0]] = np.multiply(2.0 * belt.half, _KICKS)
    while True:
        places = []
        for _ in range(_BLOCK):
            lead, rate, off = leads @ state, rates @ state, np.zeros((size, len(_KICKS)))
            for at in range(0, 2 * count, 2):  # by the midpoint
                middle = half @ off + pushed_half * belt.lacks(lead[at] + off[LEAD], rate[at] + off[LEAD_RATE])
                off = whole @ off + pushed * belt.lacks(lead[at + 1] + middle[0], rate[at + 1] + middle[1])
            state += change @ state
            state[own] += off
            state[parts["last_step"]] += off[:1]
            places.append(plant.bodies @ state[own])
        yield np.ptp(places, axis=0)
