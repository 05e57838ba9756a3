"""How the points of a scene under CORDIS's scheme answer forces at a place z of the complex plane.

A motion x z^n of the points under forces f z^n obeys D(z) x = f, D (points, points): on the diagonal m/T² (z - 2 + 1/z)
of a simulated mass, or 1/G(z) of a channel, G from the computed force to the reading; and for each link K + (B/T) v(z)
at its two ends, v its damper's velocity over the position.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.device_step import DeviceStep
from hapsim.theory.interface import damper_answer
from hapsim.theory.network.large_loop import factorised
from hapsim.theory.network.network import Network, acting_links
from hapsim.theory.sample import channel_steps

AT_ONCE = 4_000_000  # complex numbers in memory
MOST_DENSE = 400  # points; a sparse factorisation takes less time above


class Places(NamedTuple):
    """Places (n,) of the complex plane: z, and w = z - 1 to all its digits."""

    z: Complexes
    w: Complexes


def on_circle(angle: Floats, outside: float = 0.0) -> Places:
    """The places at these angles on a circle whose radius is 1 and ``outside``."""
    unit: Complexes = np.exp(1j * angle)
    w = outside * unit - 2.0 * np.sin(0.5 * angle) ** 2 + 1j * np.sin(angle)
    return Places((1.0 + outside) * unit, w)


def channel_answer(step: DeviceStep, z: Complexes, w: Complexes) -> tuple[Complexes, Complexes]:
    """What the device reads after a force T²/m F z^n: its position, and its velocity times T."""
    force = [sum((f * z**-age for age, f in enumerate(row) if f), 0.0 * z) for row in step.forces]
    (aa, ab), (ba, bb) = step.motion[:2]
    determinant = (w - aa) * (w - bb) - ab * ba
    position = ((w - bb) * force[0] + ab * force[1]) / determinant
    velocity = (ba * force[0] + (w - aa) * force[1]) / determinant
    if not (step.motion[2].any() or step.forces[2].any()):
        return position, velocity
    ahead, mean_velocity = (
        (of_position * position + of_velocity * velocity + pushed) / z
        for (of_position, of_velocity), pushed in zip(step.motion[2:], force[2:], strict=True)
    )
    return position - ahead, mean_velocity


class SceneMatrix:
    """D as a sum of constant matrices times functions of z: 1, the inertia, the velocities, the channels' 1/G."""

    def __init__(self, network: Network) -> None:
        self._network = network
        self._channels, self._points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
        links = acting_links(network)
        self._dampers = list(dict.fromkeys(network.damper[link] for link in links))
        number = {damper: i for i, damper in enumerate(self._dampers)}
        own = np.array([number[network.damper[link]] for link in links], dtype=np.intp)
        ends = network.ends[links]
        senses = np.array([damper.senses for damper in self._dampers], dtype=bool)[own]
        sensed = senses[:, None] & (ends >= 0) & (ends < self._channels)
        # Each end's velocity is that of its damper, or one that the device senses there.
        self._velocity = np.full((len(network.ends), 2), -1)
        self._velocity[links] = np.where(sensed, len(self._dampers) + ends, own[:, None])
        self._place_entries(links, ends)

    def _place_entries(self, links: Indices, ends: Indices) -> None:
        """The places (entries,) in which D is not zero, column by column, and each function's share there."""
        network, points = self._network, self._points
        plants = 2 + len(self._dampers) + self._channels
        channel, mass = np.arange(self._channels), np.arange(self._channels, points)
        entries = [
            (mass, mass, 0 * mass + 1, network.point_mass),
            (channel, channel, plants + channel, 0 * channel + 1.0),
        ]
        for row, column in ((0, 0), (0, 1), (1, 0), (1, 1)):
            met = (ends[:, row] >= 0) & (ends[:, column] >= 0)
            a, b, some = ends[met, row], ends[met, column], links[met]
            sign = 1.0 if row == column else -1.0
            entries.append((a, b, 0 * a, sign * network.stiffness[some]))
            entries.append((a, b, 2 + self._velocity[some, column], sign * network.damping[some] * network.rate))
        rows, columns, function, value = (np.concatenate(part) for part in zip(*entries, strict=True))
        place, entry = np.unique(columns * points + rows, return_inverse=True)
        self._columns, self._rows = np.divmod(place, max(points, 1))
        self._shares = np.zeros((plants + self._channels, place.size))
        np.add.at(self._shares, (function, entry), value)

    def functions(self, places: Places) -> Complexes:
        """(functions, n) at these places of the closed loop."""
        z, w = places
        read = [channel_answer(step, z, w) for step in channel_steps(self._network)]
        unit = self._network.channel_mass * self._network.rate**2
        velocity = [damper_answer(damper, z, w) for damper in self._dampers] + [v / x for x, v in read]
        plants = [own / x for own, (x, _) in zip(unit, read, strict=True)]
        return np.array([np.ones_like(z), w * w / z * self._network.rate**2, *velocity, *plants])

    def ideal_functions(self, s: Complexes) -> Complexes:
        """(functions, n) of the scene in continuous time, s (n,) in 1/s, with ideal dampers and without a device."""
        velocity = np.tile(s / self._network.rate, (len(self._dampers) + self._channels, 1))
        return np.concatenate([np.ones_like(s)[None], s[None] ** 2, velocity, np.zeros((self._channels, s.size))])

    def without_plants(self, functions: Complexes) -> tuple[Complexes, Complexes]:
        """The functions without the channels' 1/G, and these, (n, C), N/m."""
        scene, plants = np.split(functions, [len(functions) - self._channels])
        return np.concatenate([scene, 0.0 * plants]), plants.T

    def dense(self, functions: Complexes) -> Complexes:
        """(n, points, points): D at n places."""
        out = np.zeros((functions.shape[1], self._points, self._points), dtype=complex)
        out[:, self._rows, self._columns] = functions.T @ self._shares
        return out

    def sparse(self, functions: Complexes) -> Any:
        """D at one place, functions (functions,), as scipy's matrix by compressed columns."""
        from scipy.sparse import csc_matrix

        begin = np.searchsorted(self._columns, np.arange(self._points + 1))
        return csc_matrix((functions @ self._shares, self._rows, begin), (self._points, self._points))

    def forms(self, motions: Complexes) -> Complexes:
        """(functions, n): x' A x of each function's matrix A and each of the motions x (points, n)."""
        return np.asarray(self._shares @ (motions[self._rows] * motions[self._columns]))

    def changes(self, places: Places, links: Indices) -> Complexes:
        """(2, links, n): by what part of itself a link's stiffness, and its damping, has to grow for a pole to be at
        these places, where that is real.

        A link's K made (1 + s) K adds s K e e' to D, e its two ends, and the determinant becomes
        det D (1 + s K e' D^-1 e): s = -1/(K e' D^-1 e). For its B the second e has the velocities of the ends.
        """
        functions = self.functions(places)
        ends = self._network.ends[links]
        pushed = np.zeros((self._points + 1, links.size))  # a ground, -1, is the last
        pushed[ends[:, 0], np.arange(links.size)] = 1.0
        pushed[ends[:, 1], np.arange(links.size)] -= 1.0
        first, second = self._answers(functions, pushed[:-1], ends)
        velocity = [functions[2 + self._velocity[links, end]] for end in (0, 1)]
        stiffness, damping = self._network.stiffness[links], self._network.damping[links] * self._network.rate
        with np.errstate(all="ignore"):
            of_stiffness = -1.0 / (stiffness[:, None] * (first - second))
            return np.stack([of_stiffness, -1.0 / (damping[:, None] * (velocity[0] * first - velocity[1] * second))])

    def _answers(self, functions: Complexes, pushed: Floats, ends: Indices) -> Complexes:
        """(2, links, n): the positions of each link's ends, pushed apart by 1 N."""
        out = np.zeros((2, len(ends), functions.shape[1]), dtype=complex)
        step = 1 if self._points > MOST_DENSE else max(1, AT_ONCE // self._points**2)
        number = np.arange(len(ends))
        for start in range(0, functions.shape[1], step):
            part = slice(start, start + step)
            if self._points > MOST_DENSE:
                solve = factorised(self.sparse(functions[:, start]))
                found = (np.full(pushed.shape, np.nan) if solve is None else solve(pushed.astype(complex)))[None]
            else:
                found = _solved(self.dense(functions[:, part]), pushed)
            for end in (0, 1):
                met = np.where(ends[:, end, None] >= 0, found[:, ends[:, end], number].T, 0.0)
                out[end, :, part] = met
        return out


def _solved(matrices: Complexes, pushed: Floats) -> Complexes:
    """(n, points, links): NaN where a matrix has no inverse."""
    try:
        return np.asarray(np.linalg.solve(matrices, pushed.astype(complex)))
    except np.linalg.LinAlgError:
        if len(matrices) == 1:
            return np.full((1, *pushed.shape), np.nan, dtype=complex)
        return np.concatenate([_solved(one[None], pushed) for one in matrices])
