"""Gaussian elimination of one sparse pattern with many numbers at once, and the inverse where the pattern is.

The pattern is that of a scene: two points are neighbours where a link joins them. Points are eliminated in rounds,
those of the fewest neighbours first and never two neighbours in one round, so that a round is one operation on arrays:
a string loses its ends, a tree its leaves, and nothing is added to the pattern. Nothing is pivoted: on the unit circle
and outside it the loss of the simulated dampers keeps the pivots from zero.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Complexes, Indices

TOGETHER = 2  # neighbours: points of so many or fewer are eliminated in one round, every other one of a string


class Round(NamedTuple):
    """Points eliminated together, g of them with r neighbours each, as slots of the matrix's entries.

    ``pivot`` (g,), ``right`` and ``below`` (g, r): the entries of their rows and columns, ``among`` (g, r, r): those
    between their neighbours. ``apart``: for each of several passes which of the flat ``among`` are changed in it, so
    that in no pass a slot comes twice.
    """

    pivot: Indices
    right: Indices
    below: Indices
    among: Indices
    apart: list[Indices]


class Pattern:
    """Where a matrix of ``points`` rows has entries, and the order in which it is eliminated.

    Attributes:
        slots: how many entries there are, those that the elimination adds included; the diagonal's are the first.
        work: multiplications of one elimination, about; the inverse takes as many.
    """

    def __init__(self, points: int, pairs: NDArray[np.intp], last: int = 0, most: int = 10**9) -> None:
        """``pairs`` (E, 2): neighbours; the points before ``last`` are eliminated after all the others.

        Given up, ``complete`` False, where it takes more than ``most`` entries.
        """
        self._slot: dict[tuple[int, int], int] = {(i, i): i for i in range(points)}
        neighbours: list[set[int]] = [set() for _ in range(points)]
        for a, b in pairs.tolist():
            if a != b:
                neighbours[a].add(b)
                neighbours[b].add(a)
                self._place(a, b)
        self.rounds: list[Round] = []
        for left in (range(last, points), range(last)):
            waiting = [(len(neighbours[point]), point) for point in left]
            heapq.heapify(waiting)
            gone: set[int] = set()
            while len(self._slot) <= most and (chosen := _chosen(waiting, gone, neighbours)):
                gone.update(chosen)
                for point in self._eliminate(chosen, neighbours):
                    if point in left:
                        heapq.heappush(waiting, (len(neighbours[point]), point))
        self.slots = len(self._slot)
        self.complete = self.slots <= most
        self._round_of = np.full(self.slots + 1, len(self.rounds))
        for number, r in reversed(list(enumerate(self.rounds))):
            for slots in (r.pivot, r.right, r.below):
                self._round_of[slots] = number
        self.work = sum(r.pivot.size * (1 + r.right.shape[1]) ** 2 for r in self.rounds)

    def slots_of(self, row: Indices, column: Indices) -> Indices:
        """The slots of these entries, which are in the pattern."""
        return np.array([self._slot[pair] for pair in zip(row.tolist(), column.tolist(), strict=True)], dtype=np.intp)

    def rounds_before(self, slots: Indices) -> int:
        """How many of the first rounds ``invert`` may leave out where only the entries in these slots are wanted."""
        return int(self._round_of[slots].min(initial=len(self.rounds)))

    def _place(self, a: int, b: int) -> None:
        for pair in ((a, b), (b, a)):
            self._slot.setdefault(pair, len(self._slot))

    def _eliminate(self, chosen: list[int], neighbours: list[set[int]]) -> set[int]:
        """Adds the rounds of these points; the points that they were next to."""
        groups = defaultdict(list)
        for point in chosen:
            around = sorted(neighbours[point])
            groups[len(around)].append((point, around))
            for a in around:
                neighbours[a].discard(point)
                for b in around:
                    if a < b and b not in neighbours[a]:
                        neighbours[a].add(b)
                        neighbours[b].add(a)
                        self._place(a, b)
        for size, members in groups.items():
            slot = self._slot
            pivot = np.array([slot[p, p] for p, _ in members], dtype=np.intp)
            right = np.array([[slot[p, a] for a in around] for p, around in members], dtype=np.intp)
            below = np.array([[slot[a, p] for a in around] for p, around in members], dtype=np.intp)
            among = np.array([[[slot[a, b] for b in around] for a in around] for _, around in members], dtype=np.intp)
            shape = (len(members), size)
            among = among.reshape(*shape, size)
            self.rounds.append(Round(pivot, right.reshape(shape), below.reshape(shape), among, _passes(among)))
        return {around for members in groups.values() for _, all_around in members for around in all_around}


def _chosen(waiting: list[tuple[int, int]], gone: set[int], neighbours: list[set[int]]) -> list[int]:
    """The points of the fewest neighbours, no two of them next to each other, taken from the heap."""
    chosen: list[int] = []
    put_back, barred = [], set()
    least = None
    while waiting and (least is None or waiting[0][0] <= max(least, TOGETHER)):
        degree, point = heapq.heappop(waiting)
        if point in gone or degree != len(neighbours[point]) or point in chosen[-1:]:
            continue
        least = degree if least is None else least
        if point in barred:
            put_back.append((degree, point))
        else:
            chosen.append(point)
            barred |= neighbours[point]
    for entry in put_back:
        heapq.heappush(waiting, entry)
    return chosen


def _passes(among: Indices) -> list[Indices]:
    """The flat indices, split so that no slot comes twice in one of the parts."""
    flat = among.ravel()
    order = np.argsort(flat, kind="stable")
    ordered = flat[order]
    first = np.flatnonzero(np.r_[True, ordered[1:] != ordered[:-1]]) if flat.size else np.zeros(0, np.intp)
    repeat = np.arange(flat.size) - np.repeat(first, np.diff(np.append(first, flat.size)))
    return [order[repeat == n] for n in range(int(repeat.max(initial=-1)) + 1)]


def eliminate(pattern: Pattern, entries: Complexes) -> None:
    """Turns the entries (slots, n) of n matrices, in place, into pivots and what stands right of and below them."""
    for r in pattern.rounds:
        if not r.right.shape[1]:
            continue
        right = entries[r.right] / entries[r.pivot][:, None]
        change = (entries[r.below][:, :, None] * right[:, None, :]).reshape(r.among.size, -1)
        flat = r.among.ravel()
        for some in r.apart:
            entries[flat[some]] -= change[some]


def invert(pattern: Pattern, entries: Complexes, leave_out: int = 0) -> None:
    """Turns what ``eliminate`` left, in place, into the entries of the inverses, but for the first rounds' points."""
    for r in reversed(pattern.rounds[leave_out:]):
        pivot = 1.0 / entries[r.pivot]
        if r.right.shape[1]:
            right = entries[r.right] * pivot[:, None]
            below = entries[r.below] * pivot[:, None]
            among = entries[r.among]
            to_the_right = -(right[:, :, None] * among).sum(axis=1)
            entries[r.below] = -(among * below[:, None, :]).sum(axis=2)
            entries[r.right] = to_the_right
            pivot = pivot - (to_the_right * below).sum(axis=1)
        entries[r.pivot] = pivot
