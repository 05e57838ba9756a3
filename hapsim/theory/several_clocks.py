"""Loop of several ports, each with a clock of its own, at frozen phases of these clocks.

Between its ticks a port needs nothing of the others: its device moves exactly through a whole sample period
(``device_step.py``). So a sample period of all ports is the product of their ticks, in the order of their phases. At
its tick a port takes the points of others that its links touch as further channels, at positions extrapolated linearly
to this tick: with p0 and p1 the two newest, and a the age of p0 in sample periods, p0 + a (p0 - p1). Its dampers take
these positions like those of its own hands. Masses are known one step ahead, so they are interpolated.

The matrix of a tick is made once: of it the phases change only where it takes the points of others.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.network.network import Network, joined_points, picked
from hapsim.theory.plant import RIGID
from hapsim.theory.rows import Rows, cut, sensed_channels

SampleOf = Callable[[Network], Any]
"""Returns the ``Sample`` of a network on one clock; its module imports this one."""

_OF_CHANNELS = ("lag", "last_step", "held")
_OF_SENSED = ("mean_velocity", "sensed_change")


class _Port:
    """One port: its ``own`` channels, the ``away`` points of others that its links touch, its ``masses``, all by their
    numbers in the whole network, and the sample of its own network, whose points they are in this order.

    ``places``: of each part of its state, the numbers in the whole state; -1: the number is always 0.
    """

    def __init__(self, network: Network, number: int, sample_of: SampleOf) -> None:
        assert network.clocks is not None
        channels, owners = network.channel_mass.size, np.array(network.clocks.port, np.intp)
        place, point = joined_points(network)
        links = np.unique(place[owners[point] == number])
        own = np.flatnonzero(owners == number)
        self.own, self.masses = own[own < channels], own[own >= channels]
        self.away = np.setdiff1d(point[np.isin(place, links)], own)
        self.sample = sample_of(self._network(network, number, links))
        self.places: dict[str, Indices] = {}

    def _network(self, network: Network, number: int, links: Indices) -> Network:
        """Returns the port's own network; the away points have any mass."""
        assert network.clocks is not None
        drives = [*(network.drives[c] for c in self.own.tolist()), *[RIGID] * self.away.size] if network.drives else ()
        points, hands = np.concatenate([self.own, self.away, self.masses]), self.own.size + self.away.size
        interface = network.clocks.interfaces[number]._asdict()
        return picked(network, points, hands, links, clocks=None, drives=drives, **interface)

    def put(self, head: Mapping[str, int], begin: int) -> int:
        """Fills ``places``: in the parts of the whole state (``SeveralClocks``) that begin at ``head``, and from
        ``begin`` on. Returns the next free number."""
        own, each, free = self.own.size, self.own.size + self.away.size, begin
        sensed = sensed_channels(self.sample.network) < own
        for name, size in self.sample.sizes.items():
            at = np.full(size, -1)
            if name == "mass":
                at[:] = self.masses
            elif name in {"velocity", "inner"}:
                for i in range(size // max(each, 1)):
                    at[i * each : i * each + own] = head[name] + i * head["mass"] + self.own
            else:
                kept = np.ones(size, bool)
                if name in _OF_CHANNELS:
                    kept = np.arange(size) % max(each, 1) < own
                elif name in _OF_SENSED:
                    kept = sensed
                elif name == "position":
                    at[:own], kept[:own] = self.own, False
                at[kept] = free + np.arange(kept.sum())
                free += int(kept.sum())
            self.places[name] = at
        return free


class SeveralClocks:
    """Change of the whole state in a sample period, for any phases.

    ``sizes``: sizes of the state's parts. They are positions, velocities and inner states as in ``Sample``, of every
    channel at its own port's tick; then everything else that the ports remember: the rest of their states, the
    positions of away points that they took last, and the two newest positions of each point that others touch.
    ``points`` (C + M, n): positions as read.
    """

    def __init__(self, network: Network, sample_of: SampleOf) -> None:
        assert network.clocks is not None
        channels, points = network.channel_mass.size, network.channel_mass.size + network.point_mass.size
        self._owners, self._substeps = np.array(network.clocks.port, np.intp), network.substeps
        self._ports = {p: _Port(network, p, sample_of) for p in np.unique(self._owners).tolist()}
        inner = max((one.inner for one in network.drives), default=0)
        head = {"position": 0, "mass": channels, "velocity": points, "inner": points + channels}
        self._inner, free = head["inner"] + np.arange(inner * channels), head["inner"] + inner * channels
        for port in self._ports.values():
            free = port.put(head, free)
        shared = np.unique(np.concatenate([port.away for port in self._ports.values()])).tolist()
        self._newest = {point: (free + 2 * i, free + 2 * i + 1) for i, point in enumerate(shared)}
        self.size, self._hands = free + 2 * len(shared), channels
        kept = {"position": channels, "mass": points - channels, "velocity": channels, "inner": inner * channels}
        self.sizes = kept | {"of_ports": self.size - sum(kept.values())}
        self.points = np.zeros((points, self.size))
        for port in self._ports.values():
            read = port.sample.points(self._state(port, self.size))
            of = np.arange(len(read)) < port.own.size
            self.points[port.own], self.points[port.masses] = read[of], read[of.size - port.masses.size :]
        self._ticks = {p: self._tick(port) for p, port in self._ports.items()}

    @property
    def ports(self) -> list[int]:
        """Numbers of the ports that have points."""
        return list(self._ports)

    def _state(self, port: _Port, columns: int) -> dict[str, Rows]:
        """Returns the port's state, on rows (n, `columns`) of the whole state."""
        rows = np.vstack([np.eye(self.size, columns), np.zeros(columns)])
        return {name: rows[at] for name, at in port.places.items()}

    def _tick(self, port: _Port) -> Floats:
        """Returns the change (n, n + A) of the whole state in the port's tick, from it and from the positions at which
        the port takes its A away points."""
        columns, own, sample = self.size + port.away.size, port.own.size, port.sample
        state, taken = self._state(port, columns), np.eye(port.away.size, columns, self.size)
        aside = taken - state["position"][own:]
        state["position"] = np.vstack([state["position"][:own], taken])
        state["last_step"] = np.vstack([state["last_step"][:own], aside])
        moved = sample.moved(sample.start(state))
        changes = cut(sample.state_change(state, moved), sample.sizes)
        changes["position"] = np.vstack([changes["position"][:own], aside])
        out, one = np.zeros((self.size, columns)), np.eye(self.size, columns)
        of_port = np.isin(np.arange(self._inner.size) % max(self._hands, 1), port.own)
        lacking = np.setdiff1d(self._inner[of_port], port.places["inner"])
        out[lacking] = -one[lacking]  # inner states that a port's channels lack vanish
        for name, at in port.places.items():
            out[at[at >= 0]] = changes[name][at >= 0]
        for i, point in enumerate((*port.own.tolist(), *port.masses.tolist())):
            if point in self._newest:
                now, before = self._newest[point]
                out[now] = self.points[point] @ one + (moved["mass"][i - own] if i >= own else 0.0) - one[now]
                out[before] = one[now] - one[before]
        return out

    def _extrapolated(self, port: _Port, ages: Mapping[int, float]) -> Floats:
        """Positions (A, n) at which a port takes its away points. ``ages``: sample periods since the newest tick of
        each other port; a mass is known one step ahead."""
        rows = np.zeros((port.away.size, self.size))
        for row, point in zip(rows, port.away.tolist(), strict=True):
            now, before = self._newest[point]
            age = ages[int(self._owners[point])] - (0.0 if point < self._hands else 1.0 / self._substeps)
            row[now], row[before] = 1.0 + age, -age
        return rows

    def change(self, phases: Sequence[float]) -> Floats:
        """Change (n, n) of the state in a sample period, from just before the first tick on. ``phases``: as in
        ``Clocks``; empty: every port takes the positions of the others at the same instant."""
        whole, done, size = np.zeros((self.size, self.size)), set[int](), self.size
        if not phases:
            return sum(
                (t[:, :size] + t[:, size:] @ self.points[self._ports[p].away] for p, t in self._ticks.items()), whole
            )
        for p in sorted(self._ports, key=lambda one: phases[one]):
            ages = {other: phases[p] - phases[other] + (other not in done) for other in self._ports}
            tick = self._ticks[p]
            tick = tick[:, :size] + tick[:, size:] @ self._extrapolated(self._ports[p], ages)
            whole += tick + tick @ whole
            done.add(p)
        return whole


def noise_gain(age: float) -> float:
    """Rms of the velocity of a damper by T/sigma, for white noise sigma of the positions of another port that are
    ``age`` sample periods old: √2 of age 0, √14 of age 1. The difference of two extrapolated positions is
    (1 + a) p0 - (1 + 2 a) p1 + a p2."""
    return math.hypot(1.0 + age, 1.0 + 2.0 * age, age)
