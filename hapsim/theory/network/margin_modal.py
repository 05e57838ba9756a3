"""The links' answers of a scene whose structures swing in modes of their own: a membrane, many springs on one skin.

The links of which no margin is asked, those inside structures, tie the masses among themselves and to grounds. Where
their dampings brake each of their modes by itself, as equal links and an equal friction do, D without the other links
is diagonal in those modes, and what its points answer to forces is a sum over them,

    R_ij(z) = sum of V_ik V_jk / (w²/(T² z) + kappa_k + (v(z)/T) beta_k),    V' M V = 1, V' K V = kappa, V' B V = beta.

Only the few points that the other links hold are wanted; with L those links' own part of D, D^-1 there is
(1 + R L)^-1 R. One decomposition takes the place of an elimination for each place on the circle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.interface import DAMPERS, DamperModel
from hapsim.theory.network.margin_response import AT_ONCE, PAIRS, Answer, at_places, channel_answer, damper_answer
from hapsim.theory.network.network import Network, acting_links, part_of_each
from hapsim.theory.network.state import channel_steps

MOST_MASSES = 2000  # of a part: its modes take a few seconds
MOST_ANGLES = 50_000  # for the hands' links
MOST_HELD = 50  # points that are held: for each place on the circle a system of so many equations
ROUNDING = 1e-15  # of the largest damping of a mode, times the number of modes: what rounding couples two modes by


class NotModalError(Exception):
    """The scene's structures do not swing in modes of their own, or in too many."""


class Part(NamedTuple):
    """A connected part's modes (n,) and how the held points among its own move in them.

    Attributes:
        held: (h,) numbers of those points among all that are held. shapes: (h, n) V, 1/sqrt(kg).
        stiffness: (n,) kappa, 1/s². damping: (n,) beta, 1/s. damper: whence the velocities come.
    """

    held: Indices
    shapes: Floats
    stiffness: Floats
    damping: Floats
    damper: DamperModel


class ModalResponse:
    """The answers of the links of which a margin is asked, at any place of the circle.

    Attributes:
        links: (n,) those that join two points or a point and a ground; the answers are theirs.
        work: multiplications for each place.
    """

    most_angles = MOST_ANGLES

    def __init__(self, network: Network) -> None:
        """Raises NotModalError."""
        margin_links = len(network.ends) if network.margin_links is None else network.margin_links
        acting = acting_links(network)
        self._network, self._steps = network, channel_steps(network)
        self.links, inner = acting[acting < margin_links], acting[acting >= margin_links]
        ends = network.ends[self.links]
        self._held = np.unique(ends[ends >= 0])
        if self._held.size > MOST_HELD:
            raise NotModalError
        self._end = np.where(ends >= 0, np.searchsorted(self._held, ends), self._held.size)  # a ground is the last
        self._parts = _parts(network, self._held, inner)
        self._modes = sum(part.stiffness.size for part in self._parts)
        self.work = max(1, sum(part.held.size**2 * part.stiffness.size for part in self._parts) + self._held.size**3)

    def at_once(self, links: int) -> int:
        """For how many angles the answers of so many links fit in memory."""
        return max(1, AT_ONCE // (self._modes + 4 * (self._held.size + 1) ** 2 + 8 * links + 1))

    def at(self, angle: Floats, only: Indices | None = None) -> Answer:
        """The answers at exp(j angle), (n,) angles from 0 to pi: of all links, or of ``only`` some, by number."""
        some = np.arange(self.links.size) if only is None else only
        z, w = at_places(angle)
        read = self._read(z, w)
        velocity = [[self._velocity(link, end, read, z, w) for end in (0, 1)] for link in range(self.links.size)]
        held = self._held.size
        alone = self._alone(read, z, w)
        inverse = np.zeros((angle.size, held + 1, held + 1), dtype=complex)
        inverse[:, :held, :held] = np.linalg.solve(np.eye(held) + alone @ self._tied(velocity, angle.size), alone)
        a, b = self._end[some].T
        first = (inverse[:, a, a] - inverse[:, a, b]).T  # of D^-1 e, at the first end
        second = (inverse[:, b, a] - inverse[:, b, b]).T
        moved = [velocity[link][0] * f - velocity[link][1] * s for link, f, s in zip(some, first, second, strict=True)]
        stiffness = self._network.stiffness[self.links[some], None]
        damping = self._network.damping[self.links[some], None] * self._network.rate
        return Answer(-1.0 / (stiffness * (first - second)), -1.0 / (damping * np.array(moved).reshape(first.shape)))

    def _read(self, z: Complexes, w: Complexes) -> dict[int, tuple[Complexes, Complexes]]:
        """What each held channel reads of a force T²/m F z^n: position and velocity."""
        channels = self._held[self._held < self._network.channel_mass.size]
        return {channel: channel_answer(self._steps[channel], z, w) for channel in channels.tolist()}

    def _velocity(
        self, link: int, end: int, read: dict[int, tuple[Complexes, Complexes]], z: Complexes, w: Complexes
    ) -> Complexes:
        """v/x at one end of a link."""
        damper, point = self._network.damper[self.links[link]], int(self._network.ends[self.links[link], end])
        if damper.senses and point in read:
            return read[point][1] / read[point][0]
        return damper_answer(damper, z, w)

    def _alone(self, read: dict[int, tuple[Complexes, Complexes]], z: Complexes, w: Complexes) -> Complexes:
        """(angles, held, held): R, what the held points answer where none of the judged links is."""
        out = np.zeros((z.size, self._held.size, self._held.size), dtype=complex)
        rate = self._network.rate
        for number, (channel, (position, _)) in enumerate(read.items()):  # the channels are the first
            out[:, number, number] = position / (self._network.channel_mass[channel] * rate**2)
        for part in self._parts:
            answers = np.outer(part.stiffness, np.ones_like(z)) + np.outer(
                np.full(part.stiffness.size, rate**2), w * w / z
            )
            answers += np.outer(part.damping * rate, damper_answer(part.damper, z, w))
            products = (part.shapes[:, None, :] * part.shapes[None, :, :]).reshape(-1, part.stiffness.size)
            sums = products.astype(complex) @ np.reciprocal(answers, out=answers)
            out[:, part.held[:, None], part.held[None, :]] = sums.T.reshape(z.size, part.held.size, -1)
        return out

    def _tied(self, velocity: list[list[Complexes]], angles: int) -> Complexes:
        """(angles, held, held): L, the judged links' part of D."""
        held = self._held.size
        out = np.zeros((angles, held + 1, held + 1), dtype=complex)
        for number, link in enumerate(self.links.tolist()):
            stiffness, damping = self._network.stiffness[link], self._network.damping[link] * self._network.rate
            for row, column in PAIRS:
                sign = 1.0 if row == column else -1.0
                place = (slice(None), self._end[number, row], self._end[number, column])
                out[place] += sign * (stiffness + damping * velocity[number][column])
        return out[:, :held, :held]


def _parts(network: Network, held: Indices, inner: Indices) -> list[Part]:
    """The modes of each connected part in which a mass is held."""
    channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
    ends = network.ends[inner]
    if ((ends >= 0) & (ends < channels)).any():
        raise NotModalError
    part = part_of_each(ends, points)
    own = part[ends.max(axis=1)]
    return [
        _part(network, np.flatnonzero(part == number), inner[own == number], held)
        for number in np.unique(part[held[held >= channels]])
    ]


def _part(network: Network, points: Indices, links: Indices, held: Indices) -> Part:
    dampers = {network.damper[link] for link in links[network.damping[links] != 0.0].tolist()}
    if points.size > MOST_MASSES or len(dampers) > 1 or any(damper.senses for damper in dampers):
        raise NotModalError
    root = np.sqrt(network.point_mass[points - network.channel_mass.size])
    ends = network.ends[links]
    ends = np.where(ends >= 0, np.searchsorted(points, ends), points.size)
    weight = root[:, None] * root
    stiffness, shapes = np.linalg.eigh(_matrix(ends, network.stiffness[links], points.size) / weight)
    damping = shapes.T @ (_matrix(ends, network.damping[links], points.size) / weight) @ shapes
    own = np.diagonal(damping).copy()
    between = np.abs(damping - np.diag(own)).max(initial=0.0)
    if not between <= ROUNDING * points.size * np.abs(own).max(initial=0.0):
        raise NotModalError
    here = np.isin(held, points)
    rows = np.searchsorted(points, held[here])
    damper = dampers.pop() if dampers else DAMPERS["backward"](0.0)
    return Part(np.flatnonzero(here), shapes[rows] / root[rows, None], stiffness, own, damper)


def _matrix(ends: Indices, of_links: Floats, points: int) -> Floats:
    """(points, points): the sum of k e e' over links, e their two ends; a ground is the last."""
    out = np.zeros((points + 1, points + 1))
    for row, column in PAIRS:
        np.add.at(out, (ends[:, row], ends[:, column]), of_links if row == column else -of_links)
    return out[:points, :points]
