"""The transition of a large scene, in the coordinates in which every motion goes by itself: that of the exact scheme.

With x = S q, where S' M S = 1 and S' K S, S' B S are diagonal, each mode is an oscillator q'' + b q' + k q = g of unit
mass, advanced by the scheme under a force g that is held. The state has q where it otherwise has the masses' x, and
q - T q' where it has x - w. What joins the modes is what pulls them from outside, on few points: the transition is a
sparse matrix F and a product U W of few columns and rows, and its inverse is Woodbury's.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Floats
from hapsim.theory.network.mass_rates import MassRates
from hapsim.theory.network.network import Network, NotWorkedOutError, inner_links, part_of_each
from hapsim.theory.network.sparse import Indices, Solve, TripletBuilder, Triplets, dense, factorised, sparse
from hapsim.theory.schemes import SCHEMES

MOST_MASSES = 2500  # that hang together: their modes take some seconds
MOST_NUMBERS = 20_000_000  # in U and W
DIAGONAL = 1e-9  # what is left beside the diagonal, as a part of the whole, where modes go by themselves
SHARES = (0.0, 0.5, 0.3819660112501051)  # of B in what the modes are those of: where K leaves open which, B decides


class Modal:
    """F + U W."""

    def __init__(self, alone: Any, columns: Floats, rows: Floats, shape: Floats, now: slice) -> None:
        self._alone, self._columns, self._rows = alone.tocsr(), columns, rows
        self._shape, self._now = shape, now
        self.size = alone.shape[0]
        self.work = max(self.size, alone.nnz // 4 + (columns.size + rows.size) // 4)

    def __matmul__(self, state: NDArray) -> NDArray:
        return np.asarray(self._alone @ state + self._columns @ (self._rows @ state))

    def inverse(self, shift: complex) -> Solve | None:
        """Solves (F + U W - shift) x = state, by Woodbury's identity; None where F - shift is singular."""
        from scipy.sparse import eye

        alone = factorised(self._alone - shift * eye(self.size, format="csc"))
        if alone is None:
            return None
        reached = alone(self._columns.astype(type(shift)))
        joined = np.eye(len(self._rows)) + self._rows @ reached

        def solve(state: NDArray) -> NDArray:
            first = alone(state.astype(reached.dtype))
            answer: NDArray = first - reached @ np.linalg.solve(joined, self._rows @ first)
            return answer

        return solve

    def positions(self, motions: NDArray) -> NDArray:
        channels = self._now.start
        return np.concatenate([motions[:channels], self._shape @ motions[self._now]])

    def is_finite(self) -> bool:
        return all(np.isfinite(part).all() for part in (self._alone.data, self._columns, self._rows))


def modal_operator(network: Network, entries: Triplets, system: MassRates, size: int) -> Modal:
    """The transition; ``entries`` of the channels and of what dampers remember, out of the state as it otherwise is."""
    shape, stiffness, damping = _modes(network)
    masses, channels = system.masses, network.channel_mass.size
    held_size = system.size - 2 * masses
    held = system.start.some(system.start.row >= 2 * masses)
    held = held._replace(row=held.row - 2 * masses)
    into = system.rates.some(system.rates.column >= 2 * masses)
    pulled = np.empty(held_size, np.intp)
    pulled[into.column - 2 * masses] = into.row - masses
    # What is read of the masses: each a row of W, x and x - w as they stand in the state.
    of_masses = np.zeros(size, bool)
    of_masses[system.now] = of_masses[system.before] = True
    read = np.unique(np.concatenate([t.column[of_masses[t.column]] for t in (entries, held)]))
    if (read.size + held_size) * size > MOST_NUMBERS:
        raise NotWorkedOutError(f"{read.size + held_size} numbers join its {masses} masses with what is outside")
    number = np.full(size, -1)
    number[read] = np.arange(read.size)
    readings = np.zeros((read.size, size))
    for slots in (system.now, system.before):
        here = number[slots] >= 0
        readings[np.ix_(number[slots[here]], slots)] = shape[here]
    pulls = dense(held.some(~of_masses[held.column]), (held_size, size))
    read_pulls = held.some(of_masses[held.column])
    pulls += dense(read_pulls._replace(column=number[read_pulls.column]), (held_size, read.size)) @ readings

    flow = _flows(network.scheme, stiffness, damping)
    alone = TripletBuilder()
    own = entries.some(~of_masses[entries.column])
    alone.add(*own)
    _add_modes(alone, flow, system.now, system.before)
    columns = np.zeros((size, read.size + held_size))
    from_read = entries.some(of_masses[entries.column])
    columns[:, : read.size] = dense(from_read._replace(column=number[from_read.column]), (size, read.size))
    pushed = shape[pulled].T * network.point_mass[pulled]  # g of T²/m F: S' F
    columns[system.now, read.size :] = flow[:, 0, 2, None] * pushed
    columns[system.before, read.size :] = (flow[:, 0, 2] - flow[:, 1, 2])[:, None] * pushed
    now = slice(channels, channels + masses)
    return Modal(sparse(alone.joined(), (size, size)), columns, np.concatenate([readings, pulls]), shape, now)


def _add_modes(alone: TripletBuilder, flow: Floats, now: Indices, before: Indices) -> None:
    """q' and q' - p' out of q and q - p."""
    for row, gain in ((now, flow[:, 0]), (before, flow[:, 0] - flow[:, 1])):
        alone.add(row, now, gain[:, 0] + gain[:, 1])
        alone.add(row, before, -gain[:, 1])


def _flows(scheme: str, stiffness: Floats, damping: Floats) -> Floats:
    """(n, 3, 3): what a sample makes of q, p = T q' and a force T² g that is held; of k T² and b T."""
    advance = SCHEMES[scheme].advance
    assert advance is not None
    rates = np.zeros((stiffness.size, 3, 3))
    unit = np.sqrt(np.maximum(1.0, stiffness))
    rates[:, 0, 1] = unit
    rates[:, 1, 0], rates[:, 1, 1], rates[:, 1, 2] = -stiffness / unit, -damping, 1.0 / unit
    flow: Floats = advance(rates, np.eye(3))
    flow[:, 1] *= unit[:, None]
    flow[:, :, 1] /= unit[:, None]
    return flow


def _modes(network: Network) -> tuple[Floats, Floats, Floats]:
    """S (M, M) in kg^-1/2, and of each mode k T² and b T, (M,), of what hangs together by the links inside."""
    channels, masses = network.channel_mass.size, network.point_mass.size
    links = inner_links(network)
    ends = np.where(network.ends[links] >= 0, network.ends[links] - channels, -1)
    part = part_of_each(ends, masses)
    own = part[ends.max(axis=1)]
    shape = np.zeros((masses, masses))
    stiffness, damping = np.zeros(masses), np.zeros(masses)
    order = np.argsort(part, kind="stable")
    for points in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        here = own == part[points[0]]
        place = np.full(masses + 1, points.size)  # a ground is the last
        place[points] = np.arange(points.size)
        found = _part_modes(network, points, place[ends[here]], links[here])
        shape[np.ix_(points, points)], stiffness[points], damping[points] = found
    return shape, stiffness, damping


def _part_modes(network: Network, points: Indices, ends: Indices, links: Indices) -> tuple[Floats, Floats, Floats]:
    if points.size > MOST_MASSES:
        raise NotWorkedOutError(f"{points.size} masses hang together, more than {MOST_MASSES}")
    root = 1.0 / np.sqrt(network.point_mass[points])
    values = (network.stiffness[links] / network.rate**2, network.damping[links] / network.rate)
    both = [root[:, None] * _matrix(ends, value, points.size) * root for value in values]
    sizes = [float(np.abs(matrix).max(initial=0.0)) or 1.0 for matrix in both]
    if not np.isfinite(sizes).all():
        raise NotWorkedOutError("its numbers are out of range")
    for share in SHARES:
        vectors = np.linalg.eigh(both[0] / sizes[0] + share * both[1] / sizes[1])[1]
        if all(_is_diagonal(vectors.T @ m @ vectors, size) for m, size in zip(both, sizes, strict=True)):
            shape = vectors * root[:, None]
            padded = np.vstack([shape, np.zeros(points.size)])
            # As sums over the links: a slow mode's are then as accurate as a fast one's.
            squares = (padded[ends[:, 0]] - padded[ends[:, 1]]) ** 2
            return shape, values[0] @ squares, values[1] @ squares
    raise NotWorkedOutError(f"damping joins the modes of its {network.point_mass.size} masses")


def _is_diagonal(matrix: Floats, size: float) -> bool:
    return bool(np.abs(matrix - np.diag(np.diag(matrix))).max(initial=0.0) <= DIAGONAL * size)


def _matrix(ends: Indices, of_links: Floats, points: int) -> Floats:
    """(points, points): the sum of k e e' over links, e their two ends; a ground is the last."""
    parts = TripletBuilder()
    for row in (0, 1):
        for column in (0, 1):
            parts.add(ends[:, row], ends[:, column], of_links if row == column else -of_links)
    return dense(parts.joined(), (points + 1, points + 1))[:points, :points]
