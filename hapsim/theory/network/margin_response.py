"""How far a scene's links stretch to a force of their own, on the unit circle: what a change of one link does.

A motion x z^n of the points obeys D(z) x = 0, D (points, points): on the diagonal m/T² (z - 2 + 1/z) of a simulated
mass or 1/G(z) of a channel, G from the computed force to the reading; and for each link K + (B/T) v(z) at its first end
and at its second, its damper's v. A link's K made (1 + s) K adds s K e e', e its two ends, and the determinant becomes
det D (1 + s K e' D^-1 e); so with its B. A pole is where that is zero, s = -1/(K e' D^-1 e), and each link's own
e' D^-1 e is in the part of the inverse that the elimination gives at once (``sparse_elimination.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.interface import DamperModel
from hapsim.theory.network.device_step import DeviceStep
from hapsim.theory.network.network import Network, acting_links
from hapsim.theory.network.sparse_elimination import Pattern, eliminate, invert
from hapsim.theory.network.state import channel_steps

OUTSIDE = 1e-12  # the circle's radius is 1 and this: poles that rest on 1, and what never loses energy, lie inside
AT_ONCE = 10_000_000  # complex numbers in memory
MOST_COEFFICIENTS = 20_000_000
MOST_ANGLES = 2500  # for the hands' links of a large scene
MOST_WORK = 300_000  # multiplications for each place on the circle, likewise
FILL = 40  # entries a point: a scene whose elimination adds more takes too long


class TooLargeError(Exception):
    """The elimination of this scene would take too long."""


class Answer(NamedTuple):
    """(links, n) each: by what part of itself K, and B, has to grow for a pole to be there; so much more is real."""

    stiffness: Complexes
    damping: Complexes


class Response:
    """The links' answers at any place of the circle.

    Attributes:
        links: (n,) those that join two points or a point and a ground; the answers are theirs.
        work: multiplications for each place.
    """

    most_angles = MOST_ANGLES

    def __init__(self, network: Network) -> None:
        channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
        self._network = network
        self._steps = channel_steps(network)
        self.links = acting_links(network)
        ends = network.ends[self.links]
        joined = ends[(ends >= 0).all(axis=1)]
        pattern = Pattern(points, joined, last=channels, most=FILL * points + 1000)
        if not pattern.complete or pattern.work > MOST_WORK:
            raise TooLargeError
        self._pattern, self._nowhere = pattern, pattern.slots
        self.work = pattern.work
        self._dampers = list(dict.fromkeys(network.damper[link] for link in self.links))
        number = {damper: i for i, damper in enumerate(self._dampers)}
        own = np.array([number[network.damper[link]] for link in self.links], dtype=np.intp)
        senses = np.array([damper.senses for damper in self._dampers], dtype=bool)
        by_device = senses[own][:, None] & (ends >= 0) & (ends < channels) if own.size else np.zeros((0, 2), bool)
        # Which of the velocities each end has: one for each damper, then one for each channel that is sensed.
        self._kind = np.where(by_device, len(self._dampers) + ends, own[:, None])
        self._slot = {pair: self._slots(ends[:, pair[0]], ends[:, pair[1]]) for pair in PAIRS}
        self._coefficients = self._linear(points, channels)
        self._memory = np.empty(0, dtype=complex)

    def _slots(self, row: NDArray[np.intp], column: NDArray[np.intp]) -> NDArray[np.intp]:
        met = (row >= 0) & (column >= 0)
        slots = np.full(row.size, self._nowhere)
        slots[met] = self._pattern.slots_of(row[met], column[met])
        return slots

    def _linear(self, points: int, channels: int) -> Complexes:
        """(slots + 1, functions): the entries as sums of 1, w²/z, the velocities and the channels' 1/G."""
        network = self._network
        kinds = len(self._dampers) + channels
        if (self._nowhere + 1) * (2 + kinds + channels) > MOST_COEFFICIENTS:
            raise TooLargeError
        out = np.zeros((self._nowhere + 1, 2 + kinds + channels), dtype=complex)
        mass = np.arange(channels, points)
        out[mass, 1] = network.point_mass * network.rate**2
        own = np.arange(channels)
        out[own, 2 + kinds + own] = network.channel_mass * network.rate**2
        for (row, column), slot in self._slot.items():
            sign = 1.0 if row == column else -1.0
            np.add.at(out[:, 0], slot, sign * network.stiffness[self.links])
            function: NDArray[np.intp] = 2 + self._kind[:, column]
            np.add.at(out, (slot, function), sign * network.damping[self.links] * network.rate)
        return out

    def at_once(self, links: int) -> int:
        """For how many angles the answers of so many links fit in memory."""
        return max(1, AT_ONCE // (self._nowhere + 8 * links + 1))

    def at(self, angle: Floats, only: NDArray[np.intp] | None = None) -> Answer:
        """The answers at exp(j angle), (n,) angles from 0 to pi: of all links, or of ``only`` some, by number."""
        some = np.arange(self.links.size) if only is None else only
        z, w = at_places(angle)
        velocity, read = self._known(z, w)
        known = [np.ones_like(z)[None], (w * w / z)[None], velocity, 1.0 / read]
        entries = np.matmul(self._coefficients, np.concatenate(known), out=self._room(z.size))
        slot = {pair: slots[some] for pair, slots in self._slot.items()}
        eliminate(self._pattern, entries)
        leave_out = 0 if only is None else self._pattern.rounds_before(np.concatenate(list(slot.values())))
        invert(self._pattern, entries, leave_out)
        entries[self._nowhere] = 0.0
        first = entries[slot[0, 0]] - entries[slot[0, 1]]  # of D^-1 e, at the first end
        second = entries[slot[1, 0]] - entries[slot[1, 1]]
        network, kind, links = self._network, self._kind[some], self.links[some]
        stiffness = network.stiffness[links, None] * (first - second)
        moved = velocity[kind[:, 0]] * first - velocity[kind[:, 1]] * second
        return Answer(-1.0 / stiffness, -1.0 / ((network.damping[links, None] * network.rate) * moved))

    def _room(self, angles: int) -> Complexes:
        """(slots + 1, angles), the same memory each time: to be given new pages takes as long as the elimination."""
        wanted = (self._nowhere + 1) * angles
        if self._memory.size < wanted:
            self._memory = np.empty(wanted, dtype=complex)
        return self._memory[:wanted].reshape(-1, angles)

    def _known(self, z: Complexes, w: Complexes) -> tuple[Complexes, Complexes]:
        """The velocities (kinds, n) that the ends have, and the readings (C, n), of forces T²/m F z^n."""
        read = [channel_answer(step, z, w) for step in self._steps]
        velocity = [damper_answer(damper, z, w) for damper in self._dampers] + [v / x for x, v in read]
        return np.array(velocity).reshape(-1, z.size), np.array([x for x, _ in read]).reshape(-1, z.size)


PAIRS = ((0, 0), (0, 1), (1, 0), (1, 1))


def at_places(angle: Floats) -> tuple[Complexes, Complexes]:
    """(n,) the places on the circle at these angles, z and w = z - 1."""
    unit: Complexes = np.exp(1j * angle)
    w = OUTSIDE * unit - 2.0 * np.sin(0.5 * angle) ** 2 + 1j * np.sin(angle)
    return (1.0 + OUTSIDE) * unit, w


def damper_answer(damper: DamperModel, z: Complexes, w: Complexes) -> Complexes:
    """v/y of the damper's recurrence; its weights of positions add up to zero, which leaves a factor 1 - 1/z = w/z."""
    from_positions = np.polyval(np.cumsum(damper.of_positions)[-2::-1], 1.0 / z)
    return w / z * from_positions / (1.0 - np.polyval([*damper.of_velocities[::-1], 0.0], 1.0 / z))


def channel_answer(step: DeviceStep, z: Complexes, w: Complexes) -> tuple[Complexes, Complexes]:
    """What the device reads after a force T²/m F z^n: its position, and its velocity times T."""
    force = [sum((f * z**-age for age, f in enumerate(row) if f), 0.0 * z) for row in step.forces]
    (aa, ab), (ba, bb) = step.motion[:2] - np.eye(2)
    determinant = (w - aa) * (w - bb) - ab * ba
    position = ((w - bb) * force[0] + ab * force[1]) / determinant
    velocity = (ba * force[0] + (w - aa) * force[1]) / determinant
    if step.window == 0.0:
        return position, velocity
    read, moved = (
        (of_position * position + of_velocity * velocity + pushed) / z
        for (of_position, of_velocity), pushed in zip(step.motion[2:], force[2:], strict=True)
    )
    return read, position * w / z if step.window == 1.0 else moved  # of a whole period nothing cancels
