"""One sample of a whole loop, on rows (``rows.py``): the change that it makes in the state."""

from __future__ import annotations

from functools import lru_cache
from itertools import zip_longest
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Floats, Indices, powered
from hapsim.theory.board_lines import board_step, own_lines
from hapsim.theory.device_step import DeviceStep, coupled_step, device_step
from hapsim.theory.follower import follower_step
from hapsim.theory.interface import SAMPLINGS, STATES, acting_at_sample, hold_lag
from hapsim.theory.network.network import Network, damping_links, kinetic_energy
from hapsim.theory.observer import Observers
from hapsim.theory.plant import RIGID, Drive, Plant
from hapsim.theory.rows import Rows, Tick, cut, sensed_channels, stack, step_weights, times, unit_rows
from hapsim.theory.several_clocks import SeveralClocks

LARGE = 1000  # numbers in the state; above, the eigenvalues of the whole matrix take too long


class Sample:
    """One sample of the whole loop in three parts: the state at the start of its steps, the steps (``Tick``), the
    device.

    ``sizes``: sizes of the state's parts, in metres. They are the channels' true positions; the masses' positions; the
    channels' velocities times T; the inner states of the channels' drives (``plant.py``), of the board's lines
    (``board_lines.py``) or of the devices after simulated masses (``follower.py``), the first of every channel first;
    the lead of the positions over their readings (averaged sampling); the last steps of the readings; the mean
    velocities that links sense (averaged sampling); the last changes of the sensed velocities (substeps); the masses'
    steps; the forces that a later sample still needs, newest first, times T²/m; the memories of the dampers; and the
    predictors' states. The state has no other parts.
    """

    def __init__(self, network: Network, sparse: bool = False) -> None:
        self.network, self.tick, self.sizes = network, Tick(network, sparse), sizes_of(network)
        self._sensed = sensed_channels(network)
        self._acceleration, self.observers = _acceleration(network), None
        if network.predictors:
            self.observers = Observers(network.predictors, network.channel_mass, network.rate)
        (self._motion, self._forces), channels = device_step_of(network), network.channel_mass.size
        self.step_sizes = {
            "hand": channels,
            "gain": channels,
            "sensed": self._sensed.size,
            "sensed_step": self._sensed.size,
            "mass": network.point_mass.size,
            "mass_step": network.point_mass.size,
            "old_steps": self.sizes["old_steps"],
            "old_rates": self.sizes["old_rates"],
            "force": channels,
        }
        if network.substeps == 1:
            del self.step_sizes["sensed_step"]

    def points(self, state: dict[str, Rows]) -> Rows:
        """Positions as the computer reads them, (C + M)."""
        return stack([self._read(state), state["mass"]])

    def _read(self, state: dict[str, Rows]) -> Rows:
        return state["position"] - state["lag"] if state["lag"].shape[0] else state["position"]

    def _seen(self, state: dict[str, Rows]) -> tuple[Rows, Rows]:
        """Channels as the links see them: positions (C), and the sensed velocities that a link uses."""
        if self.observers is not None:
            x, v = self.observers.ahead(state["observer"], state["held"])
            return x, v[self._sensed]
        x, averaged = self._read(state), state["lag"].shape[0]
        v = state["mean_velocity"] if averaged else state["velocity"][self._sensed]
        if self._acceleration is None:
            return x, v
        ahead, of_position, of_velocity, *of_forces = self._acceleration
        a = times(of_position, state["position"]) + times(of_velocity, state["velocity"])
        for age, weights in enumerate(of_forces):
            a = a + times(weights, state["held"][age * weights.size : (age + 1) * weights.size])
        return x + times(ahead, v) + times(0.5 * ahead**2, a), v + times(ahead, a)

    def start(self, state: dict[str, Rows]) -> dict[str, Rows]:
        """Returns the state before the first step: the hands at their readings of one sample ago. Over the steps, hands
        and sensed velocities move evenly to the readings of now."""
        steps, (read, sensed) = self.network.substeps, self._seen(state)
        out = {"hand": read - state["last_step"], "gain": state["last_step"] / steps, "sensed": sensed}
        if steps > 1:
            out |= {"sensed": sensed - state["sensed_change"], "sensed_step": state["sensed_change"] / steps}
        same = {name: state[name] for name in ("mass", "mass_step", "old_steps", "old_rates")}
        return out | same | {"force": 0.0 * read}

    def moved(self, start: dict[str, Rows], pushed: Rows | None = None) -> dict[str, Rows]:
        """Returns the change of what the steps move, from ``start``. ``pushed``: other forces on the masses, N, with
        one step."""
        if self.network.substeps == 1:
            return self.tick.step(start, pushed)
        return cut(powered(step_of(self), self.network.substeps) @ stack([*start.values()]), self.step_sizes)

    def state_change(
        self, state: dict[str, Rows], moved: dict[str, Rows], pushed: Rows | None = None, misread: Rows | None = None
    ) -> Rows:
        """Returns the change of the state over a sample of steps ``moved``; ``pushed``: other forces on channels, N;
        ``misread`` (R C): additions to the readings of predictors, m and m per sample period."""
        network, x, v = self.network, state["position"], state["velocity"]
        unit, force = mobility(network) / network.rate**2, moved["force"]
        acting = times(unit, force if pushed is None else force + pushed)
        held = range(0, self.sizes["held"], max(len(unit), 1))
        ranks = [acting, *(state["held"][at : at + len(unit)] for at in held)]

        inner = [state["inner"][at : at + len(unit)] for at in range(0, self.sizes["inner"], max(len(unit), 1))]

        def row(of: int) -> Rows:
            """Returns the positions (0) or velocities (1) after the sample."""
            out = times(self._motion[of, :, 0], x) + times(self._motion[of, :, 1], v)
            for number, one in enumerate(inner, 2):
                out = out + times(self._motion[of, :, number], one)
            for age, rank in enumerate(ranks[: self._forces.shape[2]]):
                out = out + times(self._forces[of, :, age], rank)
            return out

        new = {"position": row(0), "mass": moved["mass"], "velocity": row(1), "mass_step": moved["mass_step"]}
        new["inner"] = stack([row(4 + number) for number in range(len(inner))]) if inner else state["inner"]
        new["lag"] = row(2) - state["lag"] if state["lag"].shape[0] else state["lag"]
        if state["lag"].shape[0]:
            new["mean_velocity"] = row(3)[self._sensed] - state["mean_velocity"]
        new["held"] = stack(ranks)[: self.sizes["held"]] - state["held"]
        if self.observers is not None:
            read = [x + row(0) - row(2), row(3)][: self.observers.readings]
            if misread is not None:
                read = [one + misread[i * len(unit) : (i + 1) * len(unit)] for i, one in enumerate(read)]
            new["observer"] = self.observers.change(state["observer"], stack(ranks), read)
        last_step, turned = self._seen(new)
        new["last_step"] = last_step - state["last_step"]
        if network.substeps > 1:
            new["sensed_change"] = turned - state["sensed_change"]
        new |= {name: moved[name] for name in ("old_steps", "old_rates")}
        return stack([new[name] for name in self.sizes if name in new])


class Loop(NamedTuple):
    """Matrix of a loop: ``change`` (n, n), what a sample adds to the state; ``points`` (C + M, n), positions as read.
    With inputs also ``push`` (n, C + M): the change from a force of 1 N computed for a point (for the channels alone
    where points move several times a sample); ``force`` (C, n): forces computed for the channels, N; ``stretches``,
    twice (L, n): each link's stretch, and its damper's velocity in metres per sample period; ``misread`` (n, R C): the
    change from 1 m more in the next readings of predictors."""

    change: Rows
    points: Rows
    push: Rows = np.zeros((0, 0))
    force: Rows = np.zeros((0, 0))
    stretches: tuple[Rows, Rows] = (np.zeros((0, 0)),) * 2
    misread: Rows = np.zeros((0, 0))


@lru_cache(maxsize=16)
def sizes_of(network: Network) -> dict[str, int]:
    """Sizes of the state's parts, in their order (``Sample``, ``SeveralClocks``)."""
    if network.clocks is not None:
        return several_clocks(network).sizes
    channels, masses, sensed = network.channel_mass.size, network.point_mass.size, sensed_channels(network).size
    averaged, stepped = SAMPLINGS[network.sampling].window > 0.0, network.substeps > 1
    dampers = [network.damper[link] for link in damping_links(network).tolist()]
    return {
        "position": channels,
        "mass": masses,
        "velocity": channels,
        "inner": channels * _inner_states(network),
        "lag": channels * averaged,
        "last_step": channels,
        "mean_velocity": sensed * averaged,
        "sensed_change": sensed * stepped,
        "mass_step": masses,
        "held": channels * _held_forces(network),
        "old_steps": sum(len(step_weights(damper)) - 1 for damper in dampers),
        "old_rates": sum(len(damper.of_velocities) for damper in dampers),
        "observer": STATES * len(network.predictors),
    }


def _inner_states(network: Network) -> int:
    """Count of the inner states of each channel."""
    if network.board is not None:
        return network.board.memories
    each = [one.inner for one in network.drives] + [one.inner(network.delay) for one in network.followers]
    return max(each, default=0)


def state_size(network: Network) -> int:
    """Count of the numbers in the state."""
    return sum(sizes_of(network).values())


def is_large(network: Network) -> bool:
    """Returns whether the scene has too many states to compute all its poles. A planar one never has: the methods for
    large scenes follow links with two ends."""
    has_ends = network.rows is None and network.second is None
    return has_ends and network.mass_coupling is None and state_size(network) > LARGE


def several_clocks(network: Network) -> SeveralClocks:
    """Loop of a network whose ports have clocks of their own, for any phases."""
    return SeveralClocks(network, Sample)


@np.errstate(all="ignore")  # numbers out of range become NaN
def loop(network: Network, inputs: bool = False, sparse: bool = False) -> Loop:
    """Loop of a scene that is not large. On sparse rows: only with CORDIS's scheme and one step a sample. Of
    several clocks without inputs, and never sparse."""
    if network.clocks is not None:
        ports = several_clocks(network)
        return Loop(ports.change(network.clocks.phases), ports.points)
    sample = Sample(network, sparse)
    size, points = sum(sample.sizes.values()), network.channel_mass.size + network.point_mass.size
    misreads = 0 if sample.observers is None else sample.observers.readings * network.channel_mass.size
    one = unit_rows(size + (points + misreads) * inputs, sparse)
    state, pushed = cut(one[:size], sample.sizes), one[size : size + points] if inputs else None
    start, channels = sample.start(state), network.channel_mass.size
    moved = sample.moved(start, None if pushed is None else pushed[channels:])
    misread = one[size + points :] if inputs else None
    whole = sample.state_change(state, moved, None if pushed is None else pushed[:channels], misread)
    read = sample.points(state)[:, :size]
    if not inputs:
        return Loop(whole, read)
    _, stretch, rate = sample.tick.seen(start)
    stretches = stretch[:, :size], rate[:, :size]
    push, misread = whole[:, size : size + points], whole[:, size + points :]
    return Loop(whole[:, :size], read, push, moved["force"][:, :size], stretches, misread)


def step_of(sample: Sample) -> Floats:
    """Change that one step makes in what it moves, an array."""
    one = np.eye(sum(sample.step_sizes.values()))
    return stack([*sample.tick.step(cut(one, sample.step_sizes)).values()])


def _held_forces(network: Network) -> int:
    """Count of the past forces of a channel that a later sample still needs."""
    steps, sensed = channel_steps(network), _acceleration(network)
    of_motion = max((step.forces.shape[1] - 1 for step in steps), default=0)
    return max([of_motion, len(sensed) - 3 if sensed else 0, *(one.lags for one in network.predictors)])


def _acceleration(network: Network) -> list[Floats] | None:
    """Returns the samples by which links see the channels ahead, and the weights of position, velocity and T²/m f[n-1],
    T²/m f[n-2], ... in the sensed T² a, each (C,); None if they see the readings."""
    if network.ahead is None:
        return None
    mass, one = network.channel_mass, np.ones(network.channel_mass.size)
    delay, age, masses, period = network.ahead
    lag = period * (delay + hold_lag(network.hold) + SAMPLINGS[network.sampling].lag)
    added = mass / np.array(masses) if masses else 0.0 * one
    acting = (acting_at_sample(of, network.hold, old) for of, old in ((network.delay, age), (delay, age), (delay, 0)))
    own = -network.channel_stiffness / mass / network.rate**2, -network.channel_friction / mass / network.rate
    forces = (sensed * one + (now - then) * added for sensed, then, now in zip_longest(*acting, fillvalue=0.0))
    return [lag * one, *own, *forces]


def mobility(network: Network) -> Floats:
    """Inverse of the channels' masses, (C,), or (C, C) if they are a matrix."""
    if network.mass_coupling is None:
        return 1.0 / network.channel_mass
    return np.asarray(np.linalg.inv(network.mass_matrix), float)


def device_step_of(network: Network) -> DeviceStep:
    """Step of all channels: (4 + I, C, 2 + I) and (4 + I, C, ages), or that of coupled ones. Inner states that a
    channel lacks vanish in a sample."""
    if network.mass_coupling is None:
        steps, most = channel_steps(network), sizes_of(network)["inner"] // max(1, network.channel_mass.size)
        motion = np.zeros((4 + most, len(steps), 2 + most))
        forces = np.zeros((4 + most, len(steps), max((step.forces.shape[1] for step in steps), default=0)))
        motion[4:, :, 2:] = -np.eye(most)[:, None]
        for c, step in enumerate(steps):
            motion[: len(step.motion), c], forces[: len(step.forces), c] = 0.0, step.forces
            motion[: len(step.motion), c, : step.motion.shape[1]] = step.motion
        return DeviceStep(motion, forces)
    free = mobility(network) / network.rate
    own = free * network.channel_friction, free * network.channel_stiffness / network.rate
    return coupled_step(own[0], network.delay, network.hold, own[1], network.sampling)


def channel_steps(network: Network) -> list[DeviceStep]:
    """Step of each channel over one sample period, in normalised units."""
    if network.board is not None:
        unit = network.channel_mass * network.rate
        lines = np.column_stack([of / unit for of in (own_lines(network)[0] / network.rate, own_lines(network)[1])])
        each = zip(normalised_channels(network), lines.tolist(), strict=True)
        return [board_step(b, k, *line, network.delay, network.board) for (b, k, _), line in each]
    if network.followers:
        followers = zip(normalised_channels(network), network.followers, network.channel_mass.tolist(), strict=True)
        return [follower_step(b, k, network.delay, one.normalised(m, network.rate)) for (b, k, _), one, m in followers]
    return [
        device_step(float(b), network.delay, network.hold, float(k), network.sampling, drive)
        for b, k, drive in normalised_channels(network)
    ]


def normalised_channels(network: Network) -> list[tuple[float, float, Drive]]:
    """Friction b0 T/m, own spring k0 T²/m and drive of each channel, in normalised units."""
    mass, rate = network.channel_mass, network.rate
    friction = network.channel_friction / (mass * rate)
    stiffness = network.channel_stiffness / (mass * rate) / rate
    drives = network.drives or (RIGID,) * mass.size
    each = zip(friction.tolist(), stiffness.tolist(), drives, mass.tolist(), strict=True)
    return [(b, k, drive.normalised(m, rate)) for b, k, drive, m in each]


def plants_of(network: Network) -> list[Plant]:
    """Plant of each channel, with its drive, in normalised units."""
    return [drive.plant(b, k) for b, k, drive in normalised_channels(network)]


def hands_of(network: Network, states: Complexes) -> tuple[Complexes, Complexes, Floats]:
    """Positions and velocities of the channels' handles in these states of a loop (size, n), and the kinetic energy of
    motor and handle together, in any unit: (C, n) each."""
    found = []
    for places, plant, mass in zip(_places(network), plants_of(network), network.channel_mass, strict=True):
        own = states[places[: len(plant.rates)]]
        moved, handle = plant.bodies @ own, plant.bodies[-1]
        found.append([moved[-1], handle @ plant.rates @ own, mass * plant.shares @ np.abs(moved) ** 2])
    x, v, energy = np.array(found).swapaxes(0, 1)
    return x, v, energy.real


def hand_kicks(network: Network) -> Floats:
    """States (size, C) after an impulse of m 1 m per sample period on the handle of each channel."""
    kicks = np.zeros((state_size(network), network.channel_mass.size))
    for c, (places, plant) in enumerate(zip(_places(network), plants_of(network), strict=True)):
        kicks[places[: len(plant.rates)], c] = plant.push[:, 0]
    return kicks


def energy_of(network: Network, motions: NDArray, states: NDArray) -> Floats:
    """Kinetic energy (C + M, n) of each point in these motions (C + M, n) of a loop with these states (size, n)."""
    energy = kinetic_energy(network, motions)
    if network.drives:
        energy[: network.channel_mass.size] = hands_of(network, states)[2]
    return energy


def _places(network: Network) -> Indices:
    """Places of each channel's plant in the state, (C, 2 + I)."""
    sizes, channels = sizes_of(network), network.channel_mass.size
    parts = cut(np.arange(sum(sizes.values())), sizes)
    return np.concatenate([parts[name].reshape(-1, channels) for name in ("position", "velocity", "inner")]).T
