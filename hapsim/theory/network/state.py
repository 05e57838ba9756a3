"""The state of a scene from sample to sample, and the matrix that moves it, as triplets (row, column, value).

The state is, in metres and in this order: the points' positions x[n] and x[n-1] (C + M each), the channels' velocities
times T (C), with averaged sampling the channels' true positions (C) and the mean velocities of those that a link
senses, the forces computed for the channels, newest first and times T²/m, that a later sample still needs (C each), and
what the links' dampers remember: stretches y[n-2] and older, velocities v[n-1] and older. What nothing needs is not
there.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.device_step import DeviceStep, device_step
from hapsim.theory.network.layout import Layout, Memory, layout_of
from hapsim.theory.network.mass_rates import MassRates, advanced, mass_rates
from hapsim.theory.network.network import Network, acting_links, is_centred, outside_links
from hapsim.theory.network.sparse import Indices, TripletBuilder, Triplets, dense, sparse


def channel_steps(network: Network) -> list[DeviceStep]:
    """What one sample period makes of each channel, in normalised units."""
    mass, rate = network.channel_mass, network.rate
    friction = network.channel_friction / (mass * rate)
    stiffness = network.channel_stiffness / (mass * rate) / rate
    return [
        device_step(float(b), network.delay, network.hold, float(k), network.sampling)
        for b, k in zip(friction, stiffness, strict=True)
    ]


LARGE = 1000  # numbers in the state; above, eigenvalues of the whole matrix take longer than a user waits

_quietly = np.errstate(all="ignore")  # what is out of range becomes NaN


def state_size(network: Network) -> int:
    """How many numbers the state has."""
    return layout_of(network, channel_steps(network)).size


def is_large(network: Network) -> bool:
    """Whether some of the poles are worked out in place of all."""
    return state_size(network) > LARGE


@_quietly
def transition(network: Network) -> Any:
    """The square matrix that takes the state at one sample to the state at the next.

    An array; of a large scene by CORDIS's scheme a sparse one, of scipy, by compressed columns.
    """
    entries, system, size = transition_parts(network)
    if size > LARGE and system is None:
        return sparse(entries, (size, size))
    matrix = dense(entries, (size, size))
    if system is not None:
        matrix[system.now], matrix[system.before] = advanced(network, system, size)
    return matrix


@_quietly
def transition_parts(network: Network) -> tuple[Triplets, MassRates | None, int]:
    """Its entries, what another scheme than CORDIS's makes of the masses, whose rows are then empty, and its size."""
    steps = channel_steps(network)
    layout = layout_of(network, steps)
    channels, points = network.channel_mass.size, layout.now.stop
    parts = TripletBuilder()
    pull = _joined(_pulls(network, layout, parts))
    force = _on_points(network, layout, pull)
    centred = is_centred(network)
    system = None if centred else mass_rates(network, layout, _held(network, layout, pull))

    free = force.row >= channels
    if centred:
        point = np.arange(channels, points)
        parts.add(point, point, 2.0)
        parts.add(point, points + point, -1.0)
        parts.add(force.row[free], force.column[free], force.value[free])
    own = np.arange(points if centred else channels)
    parts.add(points + own, own, 1.0)

    remembered = (layout.held.stop - layout.held.start) // max(channels, 1)
    held = layout.held.start + np.arange(remembered * channels).reshape(remembered, channels)
    if remembered:
        own = ~free
        parts.add(held[0][force.row[own]], force.column[own], force.value[own])
        parts.add(held[1:], held[:-1], 1.0)
    for channel, step in enumerate(steps):
        _move_channel(layout, channel, step, force, held[:, channel], parts)
    return parts.joined(), system, layout.size


def _move_channel(
    layout: Layout, channel: int, step: DeviceStep, force: Triplets, held: Indices, parts: TripletBuilder
) -> None:
    """The rows of one channel: its true position, its velocity, and what is read of them."""
    position, velocity = layout.position.start + channel, layout.velocity.start + channel
    rows = [(position, step.motion[0], step.forces[0]), (velocity, step.motion[1], step.forces[1])]
    if layout.position.start != layout.now.start:
        rows.append((channel, step.motion[2], step.forces[2]))
    if layout.mean_velocity[channel] >= 0:
        rows.append((int(layout.mean_velocity[channel]), step.motion[3], step.forces[3]))
    mine = force.row == channel
    for row, motion, forces in rows:
        parts.add(row, position, motion[0])
        parts.add(row, velocity, motion[1])
        parts.add(row, force.column[mine], forces[0] * force.value[mine])
        parts.add(row, held, forces[1:])


def _pulls(network: Network, layout: Layout, parts: TripletBuilder) -> tuple[Triplets, Triplets]:
    """The forces of the links' (L) springs and of their dampers on their first ends, N per metre of state; into
    ``parts`` goes what the dampers remember."""
    springs, dampers = TripletBuilder(), TripletBuilder()
    acting = acting_links(network)
    _add_difference(springs, acting, network.ends[acting], 0, -network.stiffness[acting])
    for memory in layout.memories:
        velocity = _velocities(network, layout, memory, parts)
        links = memory.links[velocity.row]
        dampers.add(links, velocity.column, -network.damping[links] * network.rate * velocity.value)
    return springs.joined(), dampers.joined()


def _joined(pulls: tuple[Triplets, Triplets]) -> Triplets:
    return Triplets(*(np.concatenate(both) for both in zip(*pulls, strict=True)))


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
    for c, step in enumerate(steps):
        slots = [layout.position.start + c, layout.velocity.start + c, c, int(layout.mean_velocity[c])]
        for slot, forces in zip(slots, step.forces, strict=True):
            if slot >= 0:
                out[slot, c] = forces[0]
        if layout.held.stop > layout.held.start:
            out[layout.held.start + c, c] = 1.0
    mass = np.arange(len(steps), layout.now.stop)
    out[mass, mass] = 1.0
    return out / (np.concatenate([network.channel_mass, network.point_mass]) * network.rate**2)


def _held(network: Network, layout: Layout, pull: Triplets) -> Triplets:
    """The forces T²/m F on the points of the links that pull from outside of the scheme."""
    outside = np.zeros(len(network.ends), dtype=bool)
    outside[outside_links(network)] = True
    return _on_points(network, layout, pull.some(outside[pull.row]))


def _on_points(network: Network, layout: Layout, pull: Triplets) -> Triplets:
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


def _velocities(network: Network, layout: Layout, memory: Memory, parts: TripletBuilder) -> Triplets:
    """(links of the memory, N): the velocities v[n], m per sample period; into ``parts`` goes what is remembered."""
    damper, ends = memory.damper, network.ends[memory.links]
    number = np.arange(len(ends))
    out = TripletBuilder()
    filtered = ends
    if damper.senses:
        senses = (ends >= 0) & (ends < network.channel_mass.size)
        filtered = np.where(senses, -1, ends)
        averaged = layout.position.start != layout.now.start
        for end, sign in ((0, 1.0), (1, -1.0)):
            link, channel = number[senses[:, end]], ends[senses[:, end], end]
            out.add(link, layout.mean_velocity[channel] if averaged else layout.velocity.start + channel, sign)
    for lag, weight in enumerate(damper.of_positions):
        if lag >= 2:
            out.add(number, memory.stretches[lag - 2], weight)
        elif weight:
            _add_difference(out, number, filtered, layout.before.start * lag, np.full(len(ends), weight))
    for lag, weight in enumerate(damper.of_velocities):
        out.add(number, memory.velocities[lag], weight)
    velocity = out.joined()
    if len(memory.stretches):
        _add_difference(parts, memory.stretches[0], filtered, layout.before.start, np.ones(len(ends)))
        parts.add(memory.stretches[1:], memory.stretches[:-1], 1.0)
    if len(memory.velocities):
        parts.add(memory.velocities[0][velocity.row], velocity.column, velocity.value)
        parts.add(memory.velocities[1:], memory.velocities[:-1], 1.0)
    return velocity


def _add_difference(parts: TripletBuilder, row: Indices, ends: Indices, start: int, value: Floats) -> None:
    """``value`` times first end minus second end, of the positions whose part of the state begins at ``start``."""
    for end, sign in ((0, 1.0), (1, -1.0)):
        met = ends[:, end] >= 0
        parts.add(row[met], start + ends[met, end], sign * value[met])
