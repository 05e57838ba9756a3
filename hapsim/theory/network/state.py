"""What moves the state of a scene (``layout.py``) from sample to sample, as triplets."""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.device_step import DeviceStep, device_step
from hapsim.theory.network.layout import DamperMemory, StateLayout, layout_of
from hapsim.theory.network.mass_rates import MassRates, mass_rates
from hapsim.theory.network.network import Network, acting_links, is_centred, outside_links
from hapsim.theory.network.sparse import TripletBuilder, Triplets, dense

LARGE = 1000  # numbers in the state; above, eigenvalues of the whole matrix take longer than a user waits


def channel_steps(network: Network) -> list[DeviceStep]:
    """What one sample period makes of each channel, in normalised units."""
    mass, rate = network.channel_mass, network.rate
    friction = network.channel_friction / (mass * rate)
    stiffness = network.channel_stiffness / (mass * rate) / rate
    return [
        device_step(float(b), network.delay, network.hold, float(k), network.sampling)
        for b, k in zip(friction, stiffness, strict=True)
    ]


def state_size(network: Network) -> int:
    """How many numbers the state has."""
    return layout_of(network, channel_steps(network)).size


def is_large(network: Network) -> bool:
    """Whether some of the poles are worked out in place of all."""
    return state_size(network) > LARGE


@np.errstate(all="ignore")
def transition_parts(network: Network) -> tuple[Triplets, MassRates | None, int]:
    """Of a network whose points move once in a sample period: the entries of the matrix that takes the state at one
    sample to the state at the next, what another scheme than CORDIS's makes of the masses, whose rows are then empty,
    and its size."""
    steps = channel_steps(network)
    layout = layout_of(network, steps)
    parts = TripletBuilder()
    force, system = scene_rows(network, layout, parts)
    device_rows(layout, steps, force, parts)
    return parts.joined(), system, layout.size


def scene_rows(network: Network, layout: StateLayout, parts: TripletBuilder) -> tuple[Triplets, MassRates | None]:
    """The forces T²/m F on the points from the state, and what another scheme than CORDIS's makes of the masses; into
    ``parts`` goes what a step makes of the masses and of what dampers remember."""
    channels, points = network.channel_mass.size, layout.now.stop
    springs, dampers = _pulls(network, layout, parts)
    pull = Triplets(*(np.concatenate(both) for both in zip(springs, dampers, strict=True)))
    force = _on_points(network, layout, pull)
    if not is_centred(network):
        outside = np.isin(pull.row, outside_links(network))
        return force, mass_rates(network, layout, _on_points(network, layout, pull.some(outside)))
    mass = np.arange(channels, points)
    parts.add(mass, mass, 2.0)
    parts.add(mass, points + mass, -1.0)
    parts.add(*force.some(force.row >= channels))
    parts.add(points + mass, mass, 1.0)
    return force, None


def device_rows(layout: StateLayout, steps: list[DeviceStep], force: Triplets, parts: TripletBuilder) -> None:
    """Into ``parts``: what a sample period makes of the channels; ``force``: T²/m F on them from the state."""
    held, own = layout.held, np.arange(len(steps))
    parts.add(layout.before.start + own, own, 1.0)
    if len(held):
        point, column, value = force.some(force.row < own.size)
        parts.add(held[0][point], column, value)
        parts.add(held[1:], held[:-1], 1.0)
    for channel, step in enumerate(steps):
        _, column, value = force.some(force.row == channel)
        for row, motion, forces in zip(_slots(layout, channel), step.motion, step.forces, strict=True):
            if row >= 0:
                parts.add(row, layout.position.start + channel, motion[0])
                parts.add(row, layout.velocity.start + channel, motion[1])
                parts.add(row, column, forces[0] * value)
                parts.add(row, held[:, channel], forces[1:])


def _slots(layout: StateLayout, channel: int) -> list[int]:
    """Where the state has a channel's position, its velocity and the readings of both; -1 where it has not."""
    reading = channel if layout.is_averaged else -1
    return [
        layout.position.start + channel,
        layout.velocity.start + channel,
        reading,
        int(layout.mean_velocity[channel]),
    ]


def link_feedback(network: Network) -> tuple[Floats, Floats]:
    """u (size, L) and v (2, L, size): a link's stiffness or damping made (1 + s) times as large adds s u v' to the
    transition, under CORDIS's scheme."""
    layout = layout_of(network, channel_steps(network))
    pushed = np.hstack([entering_forces(network), np.zeros((layout.size, 1))])  # a ground, -1, is the last
    pulls = _pulls(network, layout, TripletBuilder())
    v = np.stack([dense(pull, (len(network.ends), layout.size)) for pull in pulls])
    return pushed[:, network.ends[:, 0]] - pushed[:, network.ends[:, 1]], v


def entering_forces(network: Network) -> Floats:
    """(size, C + M): the state at the next sample, out of a force of 1 N that is computed for a point at this one."""
    steps = channel_steps(network)
    layout = layout_of(network, steps)
    out = np.zeros((layout.size, layout.now.stop))
    for channel, step in enumerate(steps):
        for slot, forces in zip(_slots(layout, channel), step.forces, strict=True):
            if slot >= 0:
                out[slot, channel] = forces[0]
        out[layout.held[:1, channel], channel] = 1.0
    mass = np.arange(len(steps), layout.now.stop)
    out[mass, mass] = 1.0
    return out / (np.concatenate([network.channel_mass, network.point_mass]) * network.rate**2)


def _pulls(network: Network, layout: StateLayout, parts: TripletBuilder) -> tuple[Triplets, Triplets]:
    """The forces of the links' (L) springs and of their dampers on their first ends, N per metre of state; into
    ``parts`` goes what the dampers remember."""
    springs, dampers = TripletBuilder(), TripletBuilder()
    acting = acting_links(network)
    first, second = network.ends[acting].T
    springs.add_difference(acting, first, second, -network.stiffness[acting])
    for memory in layout.memories:
        velocity = _velocities(network, layout, memory, parts)
        links = memory.links[velocity.row]
        dampers.add(links, velocity.column, -network.damping[links] * network.rate * velocity.value)
    return springs.joined(), dampers.joined()


def _on_points(network: Network, layout: StateLayout, pull: Triplets) -> Triplets:
    """The forces T²/m F on the points (C + M) from the state, of the links' pulls."""
    link, column, value = pull
    force = TripletBuilder()
    for end, sign in ((0, 1.0), (1, -1.0)):
        point = network.ends[link, end]
        met = point >= 0
        force.add(point[met], column[met], sign * value[met])
    summed = force.joined().gathered(max(layout.size, 1))
    mass = np.concatenate([network.channel_mass, network.point_mass])
    return summed._replace(value=summed.value / (mass[summed.row] * network.rate**2))


def _velocities(network: Network, layout: StateLayout, memory: DamperMemory, parts: TripletBuilder) -> Triplets:
    """(links of the memory, N): the velocities v[n], m per sample period; into ``parts`` goes what is remembered."""
    damper, ends = memory.damper, network.ends[memory.links]
    number = np.arange(len(ends))
    senses = damper.senses & (ends >= 0) & (ends < network.channel_mass.size)
    first, second = np.where(senses, -1, ends).T
    before = layout.before.start
    out = TripletBuilder()
    for end, sign in ((0, 1.0), (1, -1.0)):
        sensed = senses[:, end]
        out.add(number[sensed], layout.sensed_slots(ends[sensed, end]), sign)
    for lag, weight in enumerate(damper.of_positions):
        if lag >= 2:
            out.add(number, memory.stretches[lag - 2], weight)
        elif weight:
            older = [np.where(end >= 0, end + before * lag, -1) for end in (first, second)]
            out.add_difference(number, older[0], older[1], weight)
    for lag, weight in enumerate(damper.of_velocities):
        out.add(number, memory.velocities[lag], weight)
    velocity = out.joined()
    if len(memory.stretches):
        previous = [np.where(end >= 0, end + before, -1) for end in (first, second)]
        parts.add_difference(memory.stretches[0], previous[0], previous[1])
        parts.add(memory.stretches[1:], memory.stretches[:-1], 1.0)
    if len(memory.velocities):
        parts.add(memory.velocities[0][velocity.row], velocity.column, velocity.value)
        parts.add(memory.velocities[1:], memory.velocities[:-1], 1.0)
    return velocity
