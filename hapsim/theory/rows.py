"""One sample of a closed loop on rows: the same code builds the loop's matrix and simulates it.

A row holds the weights with which the numbers that the loop remembers make up a signal: the position of a point, a
force that is still delayed, the velocity that a damper uses. One sample of the loop, computed on rows and stacked, is
the matrix from the state at one sample to the state at the next. Parts that a scene lacks have no rows. On one column
of numbers the same code is the simulation. Rows are arrays, or scipy's sparse matrices for a large scene.

Everything is written as a change, state' = state + change state. The poles are 1 + the eigenvalues of the change, so
slow motions keep their digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.dampers import DamperModel
from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.board_lines import own_lines
from hapsim.theory.network.network import (
    Network,
    damping_links,
    inner_links,
    is_centred,
    joined_points,
    touches_channel,
)
from hapsim.theory.schemes import SCHEMES

MOST_DENSE = 30_000  # links times points; above, a sparse matrix is faster

Rows = Any
"""Rows (n, N): an array or one of scipy's sparse matrices in CSR format."""


def times(factors: NDArray[Any], rows: Rows) -> Rows:
    """Returns each row multiplied by its factor, (n,); by factors (n, n) the rows are combined."""
    if factors.ndim == 2:
        return as_rows(factors, not isinstance(rows, np.ndarray)) @ rows
    return factors[:, None] * rows if isinstance(rows, np.ndarray) else rows.multiply(factors[:, None]).tocsr()


def stack(parts: Sequence[Rows]) -> Rows:
    """Returns the parts stacked vertically."""
    if isinstance(parts[0], np.ndarray):
        return np.vstack(parts)
    from scipy.sparse import vstack

    return vstack(parts, format="csr")


def unit_rows(count: int, sparse: bool) -> Rows:
    """Returns the rows of ``count`` signals that are the numbers themselves: the identity."""
    if not sparse:
        return np.eye(count)
    from scipy.sparse import identity

    return identity(count, format="csr")


def spread(rows: Rows, index: Indices, count: int) -> Rows:
    """Returns ``count`` rows: those given at ``index``, the others zero."""
    if isinstance(rows, np.ndarray):
        out = np.zeros((count, rows.shape[1]))
        out[index] = rows
        return out
    return _matrix(index, np.arange(index.size), np.ones(index.size), (count, index.size), True) @ rows


def _matrix(row: Indices, column: Indices, value: Floats, shape: tuple[int, int], sparse: bool) -> Any:
    if sparse:
        from scipy.sparse import csr_matrix

        return csr_matrix((value, (row, column)), shape)
    out = np.zeros(shape)
    np.add.at(out, (row, column), value)
    return out


def as_rows(values: Floats | None, sparse: bool) -> Rows:
    """Returns an array as rows."""
    if not sparse:
        return values
    from scipy.sparse import csr_matrix

    return csr_matrix(values)


def stretches_of(network: Network, sparse: bool) -> Rows:
    """Stretch of each link, (L, C + M), from the positions of channels and masses."""
    if network.rows is not None:
        return as_rows(network.rows, sparse)
    return _between_ends(network, None if network.second is None else network.second[:, 0], sparse)


def _between_ends(network: Network, second: Floats | None, sparse: bool) -> Rows:
    """Returns 1 at the first end of each link, and -1 at its second, times the weight of that, (L,)."""
    link, end = np.nonzero(network.ends >= 0)
    shape = len(network.ends), network.channel_mass.size + network.point_mass.size
    entries = np.array([1.0, -1.0])[end]
    if second is not None:
        entries = entries * np.where(end == 1, second[link], 1.0)
    return _matrix(link, network.ends[link, end], entries, shape, sparse)


def geometry_of(network: Network, sparse: bool) -> tuple[Rows, Rows]:
    """Stretch of each link, and the direction in which its tension pulls the points, each (L, C + M)."""
    stretches = stretches_of(network, sparse)
    if network.second is not None:
        return stretches, _between_ends(network, network.second[:, 1], sparse)
    return stretches, stretches if network.pulls is network.rows else as_rows(network.pulls, sparse)


def cut(rows: Rows, sizes: dict[str, int]) -> dict[str, Rows]:
    """Splits the rows into parts of these sizes."""
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: rows[end - size : end] for (name, size), end in zip(sizes.items(), ends[1:], strict=True)}


class Tick:
    """One step of a scene's links and masses, on rows.

    ``stretches``, ``pulls`` (L, C + M): stretch of each link, and direction of its force. ``old_steps``, ``old_rates``:
    lists by lag of the links whose dampers remember a step of their stretch or a velocity. ``inside`` (L,): 1 for a
    link in the rates of a scheme other than CORDIS's. ``rates``: T A of such a scheme for the masses' positions and
    steps (in ``unit``), and also for the channels' positions, steps and sensed velocities where inner links depend on
    them (``theory.schemes``).
    """

    def __init__(self, network: Network, sparse: bool = False) -> None:
        self._network, self._rate = network, network.rate * network.substeps
        self._channels, self._masses = network.channel_mass.size, network.point_mass.size
        links = network.stiffness.size
        is_sparse = sparse or links * (self._channels + self._masses) > MOST_DENSE
        self.stretches, self.pulls = geometry_of(network, is_sparse)
        acting = damping_links(network)
        kinds = list(dict.fromkeys(network.damper))
        number = {damper: i for i, damper in enumerate(kinds)}
        own = np.array([number[damper] for damper in network.damper], dtype=np.intp)
        damps = np.bincount(acting, minlength=links) > 0
        self.senses = 1.0 * (damps & np.array([damper.senses for damper in kinds], dtype=bool)[own])
        steps, velocities = [step_weights(kind) for kind in kinds], [kind.of_velocities for kind in kinds]
        self._step_weights, self._velocity_weights = _padded(steps)[own], _padded(velocities)[own]
        self.old_steps, self.old_rates = (
            [np.flatnonzero(damps & (depth[own] > lag)) for lag in range(depth.max(initial=0))]
            for depth in (np.array([len(one) - 1 for one in steps], int), np.array(list(map(len, velocities)), int))
        )
        self.damping = np.where(damps, network.damping, 0.0) * self._rate
        self._unit_force = 1.0 / network.point_mass / self._rate**2
        self._implicit = np.flatnonzero(network.implicit)
        backward = network.stiffness + self.damping * self._step_weights[:, 0]
        held = abs(self.stretches[:, self._channels + self._implicit]).T @ backward
        self._implicit_step = 1.0 / (1.0 / self._unit_force[self._implicit] + held)
        self._lines = None
        if network.board is not None:
            k, b = own_lines(network)
            self._lines = k, b * self._rate
        self._scheme = None if is_centred(network) else SCHEMES[network.scheme]
        if self._scheme is not None:
            inner = inner_links(network)
            self.inside = 1.0 * np.bincount(inner, minlength=links)
            self._needs_channels = bool(touches_channel(network, inner).any())
            self.rates, self.unit = self._rates_inside(sparse)

    def forces(self, x: Rows, step: Rows, sensed: Rows, steps: list[Rows], rates: list[Rows]) -> tuple[Rows, ...]:
        """Returns each link's pull from its first end to its second, N, its stretch, and its damper's velocity, m a
        step. ``x``, ``step``: positions and steps of the points. ``sensed``: velocities that the device senses.
        ``steps``, ``rates``: memories of the dampers, by lag."""
        stretch, moved = self.stretches @ x, self.stretches @ step
        if self.senses.any():
            aside = self.stretches[:, : self._channels] @ (sensed - step[: self._channels])
            moved = moved + times(self.senses, aside)
        rate = times(self._step_weights[:, 0], moved)
        for lists, weights, first, memories in (
            (self.old_steps, self._step_weights, 1, steps),
            (self.old_rates, self._velocity_weights, 0, rates),
        ):
            for lag, (links, memory) in enumerate(zip(lists, memories, strict=True), first):
                rate = rate + spread(times(weights[links, lag], memory), links, len(self.senses))
        return times(self._network.stiffness, stretch) + times(self.damping, rate), stretch, rate

    def masses(self, start: dict[str, Rows], pull: Rows, pushed: Rows, unknown: Rows | None = None) -> tuple[Rows, ...]:
        """Returns the changes of the masses' positions and steps, from the links' pulls and other forces ``pushed``
        (N). ``unknown``: rows that stand for the change of a scheme with no sparse one. The third part is then the
        right-hand side of (1 - share rates) unknown."""
        count, of_masses = self._masses, self.pulls[:, self._channels :].T
        if self._scheme is None:
            faster = times(self._unit_force, pushed - of_masses @ pull)
            moved = times(1.0 + self._network.implicit, faster) if self._implicit.size else faster
            return start["mass_step"] + moved, faster
        held = times(self._unit_force / self.unit, pushed - of_masses @ times(1.0 - self.inside, pull))
        z = [start["mass"], start["mass_step"] / self.unit]
        if self._needs_channels:
            z += [start["hand"] + start["gain"], start["gain"], self._sensed(start)]
        z = stack(z)
        held = spread(held, np.arange(count, 2 * count), z.shape[0])
        if unknown is None:
            change = self._scheme.changed(self.rates, z, held)
            return change[:count], change[count : 2 * count] * self.unit
        return unknown[:count], unknown[count : 2 * count] * self.unit, self.rates @ z + held

    def _sensed(self, start: dict[str, Rows]) -> Rows:
        """Sensed velocities of the channels, (C, .), m a step."""
        sensed = start["sensed"] + start["sensed_step"] if "sensed_step" in start else start["sensed"]
        return spread(sensed / self._network.substeps, sensed_channels(self._network), self._channels)

    def seen(self, start: dict[str, Rows], pushed: Rows | None = None) -> tuple[Rows, ...]:
        """Returns what ``forces`` returns, at the instant when the hands have arrived. An implicit mass, which would
        coast to its part of ``start``, is where all forces then balance; ``pushed``: as in ``step``."""
        x, step = stack([start["hand"] + start["gain"], start["mass"]]), stack([start["gain"], start["mass_step"]])
        old_steps, old_rates = _by_lag(start["old_steps"], self.old_steps), _by_lag(start["old_rates"], self.old_rates)
        found = self.forces(x, step, self._sensed(start), old_steps, old_rates)
        if not self._implicit.size:
            return found
        at = self._channels + self._implicit
        force = -(self.stretches[:, at].T @ found[0]) + (0.0 if pushed is None else pushed[self._implicit])
        moved = spread(times(self._implicit_step, force), at, x.shape[0])
        return self.forces(x + moved, step + moved, self._sensed(start), old_steps, old_rates)

    def step(self, start: dict[str, Rows], pushed: Rows | None = None, unknown: Rows | None = None) -> dict[str, Rows]:
        """Returns the change that a step makes in each part of ``start``: hands arrive, links pull, masses move.
        ``pushed``: other forces on the masses, N. ``unknown``: as in ``masses``; its equation is then the part
        "unknown"."""
        network, gain, still = self._network, start["gain"], 0.0 * start["sensed"]
        pushed = 0.0 * start["mass"] if pushed is None else pushed
        pull, _, rate = self.seen(start, pushed)
        force = -(self.pulls[:, : self._channels].T @ pull)
        more, faster, *equation = self.masses(start, pull, pushed, unknown)
        if self._lines is not None:
            force = force + self._line(start, more, faster)
        before = self.stretches @ stack([gain, more - faster]) if self.old_steps else start["old_steps"]
        out = {
            "hand": gain,
            "gain": 0.0 * gain,
            "sensed": start.get("sensed_step", still),
            "sensed_step": still,
            "mass": more,
            "mass_step": faster,
            "old_steps": _shifted(before, self.old_steps, start["old_steps"]),
            "old_rates": _shifted(rate, self.old_rates, start["old_rates"]),
            "force": force / network.substeps if network.decimation == "mean" else force - start["force"],
        }
        return {name: out[name] for name in start} | ({} if unknown is None else {"unknown": equation[0]})

    def _line(self, start: dict[str, Rows], more: Rows, faster: Rows) -> Rows:
        """Returns the part of a line beyond the force at the reading, N: k x + b v of the channel's own, which make
        that the force at x = 0 and v = 0, and what the masses' way to the next sample adds."""
        assert self._lines is not None
        stretches = self.stretches[:, self._channels :]
        at_once = times(self._network.implicit * 1.0, faster)  # part of the place at which all forces balance
        pull = times(self._network.stiffness, stretches @ (more - at_once))
        pull = pull + times(self.damping, stretches @ (faster - at_once))
        own = times(self._lines[0], start["hand"] + start["gain"]) + times(self._lines[1], start["gain"])
        return own - self.pulls[:, : self._channels].T @ pull

    def _rates_inside(self, sparse: bool) -> tuple[Rows, float]:
        """Returns the rates (N, N) and the unit of the steps: about the radians that the fastest motion turns in a
        step. In this unit no part of the rates dwarfs the others."""
        count, channels, inside = self._masses, self._channels, self.inside
        of_masses, stiffness = self.pulls[:, channels:].T, inside * self._network.stiffness
        ends = np.asarray(abs(self.stretches).sum(axis=1)).ravel()
        pace = self._unit_force * (abs(of_masses) @ (np.abs(stiffness) * ends))
        unit = max(1.0, float(np.sqrt(pace.max(initial=0.0))))
        sizes = {"mass": count, "step": count, "hand": channels, "last_step": channels, "sensed": channels}
        if not self._needs_channels:
            sizes |= {"hand": 0, "last_step": 0, "sensed": 0}
        z = cut(unit_rows(sum(sizes.values()), sparse), sizes)
        stretches = self.stretches[:, channels:]
        stretch, moved = stretches @ z["mass"], stretches @ (unit * z["step"])
        if self._needs_channels:
            of_channels = self.stretches[:, :channels]
            stretch, moved = stretch + of_channels @ z["hand"], moved + of_channels @ z["last_step"]
            moved = moved + times(self.senses, of_channels @ (z["sensed"] - z["last_step"]))
        pull = times(stiffness, stretch) + times(inside * self.damping, moved)
        faster = times(-self._unit_force / unit, of_masses @ pull)
        return stack([unit * z["step"], faster, z["last_step"], 0.0 * z["last_step"], 0.0 * z["sensed"]]), unit


@lru_cache(64)
def step_weights(damper: DamperModel) -> tuple[float, ...]:
    """Weights of y[n] - y[n-1], y[n-1] - y[n-2], ... in a damper whose weights of positions add up to 0."""
    return tuple(np.cumsum(damper.of_positions)[:-1].tolist())


def _padded(lists: Sequence[tuple[float, ...]]) -> Floats:
    out = np.zeros((len(lists), max(map(len, lists), default=0) + 1))
    for row, one in zip(out, lists, strict=True):
        row[: len(one)] = one
    return out


def _by_lag(rows: Rows, lists: list[Indices]) -> list[Rows]:
    return [*cut(rows, {str(lag): links.size for lag, links in enumerate(lists)}).values()]


def _shifted(new: Rows, lists: list[Indices], before: Rows) -> Rows:
    """Returns the change of the memories (by lag) when each moves one step further back."""
    if not lists:
        return before
    memories = _by_lag(before, lists)
    moved = [memory[np.searchsorted(near, far)] for memory, near, far in zip(memories, lists, lists[1:], strict=False)]
    return stack([new[lists[0]], *moved]) - before


def sensed_channels(network: Network) -> Indices:
    """Numbers of the channels whose sensed velocity a link uses: all where it sees them ahead."""
    if network.ahead is not None:
        return np.arange(network.channel_mass.size)
    links = [link for link in damping_links(network).tolist() if network.damper[link].senses]
    if not links:
        return np.zeros(0, np.intp)
    point = joined_points(network, np.array(links, np.intp))[1]
    return np.unique(point[point < network.channel_mass.size])
