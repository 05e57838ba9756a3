"""Gain margins: the factors on one link's stiffness, or damping, at which the whole loop becomes unstable.

For a small scene under CORDIS's scheme, one eigenvalue problem for each link and quantity gives every factor at which a
pole crosses the unit circle. For a large one the circle is sampled (both: ``crossings.py``). For the other schemes,
substeps, implicit masses and links of several rows a search tests the poles at many factors.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.crossings import Crossings, link_changes, margins_along_circle
from hapsim.theory.network.large_modes import solve
from hapsim.theory.network.modes import SURELY, settled
from hapsim.theory.network.network import (
    Network,
    is_centred,
    link_count,
    links_of_rows,
    margin_links,
    rows_of,
    touches_channel,
)
from hapsim.theory.network.phases import worst_loop
from hapsim.theory.sample import state_size

MOST_STATES = 300  # numbers in the state of a scene whose crossings are all computed
MANY_STATES = 40  # fewer eigenvalues take one thread anyway
WORK = 1.5e9  # limit of the cost of all margins: eigenvalue problems times the cube of the state's size
EIGENVALUES = 6  # problems for the two margins of a link: the crossings, and two tests of the poles
SEARCHES = 140  # the same for a search by the poles; four times as many for the ranges of an unstable loop
MOST_STATES_OF_ONE = 200  # numbers in the state up to which one link is always searched under another scheme
MOST_CLOCKED_OF_ONE = 60  # the same on several clocks
PHASE_TESTS = 8  # problems of one test over all phases; small ones take hardly longer than their set-up
MOST_CIRCLE_LINKS = 16  # links of a large scene
SURELY_OUTSIDE = 1.001  # a pole outside this radius is unstable in spite of rounding
SAME = 1e-9  # two factors closer than this are one
STEPS = 10.0 ** np.concatenate([np.arange(0.04, 1.0, 0.04), np.arange(1.0, 10.0, 0.3)])  # of a search, from 1 on

Range = tuple[float, float]
"""Range of factors: (from, to)."""
SEARCHED = f"searched up to {STEPS[-1]:.0e} times, in steps of 10 %, above 10 times of a factor 2"
"""Range and resolution of the search for margins under other schemes, and with substeps."""


class Margin(NamedTuple):
    """Factors on a link's stiffness, and on its damping, from which the loop is unstable, with everything else
    unchanged. Infinity if there is none. For an unstable loop: the largest factor below 1 under which it is stable, 0
    if there is none. NaN if it was not computed."""

    stiffness_factor: float
    damping_factor: float


class Stabilizing(NamedTuple):
    """Factors on a link's stiffness, and on its damping, that make an unstable loop stable, with everything else
    unchanged. They are the nearest range (from, to) below 1 and the nearest above, if any; open ends are 0 or infinity.
    None if they were not computed."""

    stiffness: tuple[Range, ...] | None
    damping: tuple[Range, ...] | None


class Margins(NamedTuple):
    """Margins of each link, in their order; some are NaN in a scene with many links or masses.

    Attributes:
        links: (L,). method: which were computed, and how reliably; "" for every one.
        stabilizing: (L,), of an unstable loop; else empty.
    """

    links: list[Margin]
    method: str = ""
    stabilizing: list[Stabilizing] = []  # noqa: RUF012


class _Search(NamedTuple):
    """Search for margins: the largest number of links, from the first on; the method; a link's ranges of factors."""

    most: int
    method: str
    ranges: Callable[[int, int], tuple[Range, ...]]


def margins_of(network: Network, poles: Complexes | None = None) -> Margins:
    """Returns the gain margins of each link: how far its stiffness and damping can grow before the scene becomes
    unstable. ``poles``: those of the scene, if known."""
    poles = solve(network).poles if poles is None else poles
    if not np.isfinite(poles).all():
        unknown = [Margin(math.nan, math.nan)] * link_count(network)
        return Margins(unknown, "none was worked out: the scene's numbers are out of range")
    unstable = bool((np.abs(poles) > SURELY).any())
    links = margin_links(network)
    number = links_of_rows(network)
    touching = np.isin(links, number[touches_channel(network, np.arange(number.size))])
    links = links[np.argsort(~touching, kind="stable")]
    size = state_size(network)
    centred = is_centred(network) and (network.rows is None or (size <= MOST_STATES and _is_of_rank_one(network)))
    if not centred:
        search = _by_poles(network, links.size, size, unstable)
    elif size <= MOST_STATES:
        search = _by_crossings(network, links.size, size, int(touching.sum()), unstable)
    else:
        few = links if links.size <= MOST_CIRCLE_LINKS else links[: touching.sum()]
        search = _along_circle(network, few, links.size, poles, unstable)
    with one_thread(centred and MANY_STATES < size <= MOST_STATES):
        found = {
            (link, quantity): search.ranges(link, quantity) if value[rows_of(network, link)].any() else None
            for link in links[: search.most].tolist()
            for quantity, value in enumerate((network.stiffness, network.damping))
        }
    return _collected(network, links, found, unstable)._replace(method=search.method if links.size else "")


def _is_of_rank_one(network: Network) -> bool:
    """Returns whether no link has its stiffness, or its damping, in several rows."""
    own = (links_of_rows(network)[value != 0.0] for value in (network.stiffness, network.damping))
    return all(np.bincount(links).max(initial=0) <= 1 for links in own)


def _by_crossings(network: Network, links: int, size: int, touching: int, unstable: bool) -> _Search:
    most = max(int(WORK / EIGENVALUES / (size + 40) ** 3), touching)
    crossings = Crossings(link_changes(network)) if links else None

    def ranges(link: int, quantity: int) -> tuple[Range, ...]:
        assert crossings is not None
        changed = ChangedLink(network, link, quantity)
        return changed.ranges_between(crossings.factors(changed.row, quantity), unstable)

    return _Search(most, f"{most} of {links} links, those that touch a hand first" if links > most else "", ranges)


def _by_poles(network: Network, links: int, size: int, unstable: bool) -> _Search:
    tests = SEARCHES * (4 if unstable else 1) * (PHASE_TESTS if network.clocks else 1)
    most = int(WORK / tests / (size + 40) ** 3)
    most = max(most, int(size <= (MOST_CLOCKED_OF_ONE if network.clocks else MOST_STATES_OF_ONE)))
    method = f"{SEARCHED}; an unstable range within one step is not seen"
    if not most:
        under = f"under scheme: {network.scheme}" if network.substeps == 1 else "with substeps"
        under = "with a proxy" if network.implicit.any() else under
        under = under if network.rows is None else "in the plane"
        under = "across devices" if network.clocks else under
        method = f"none was worked out: the scene has too many masses {under}"
    elif links > most:
        method = f"{most} of {links} links, those that touch a hand first; {method}"
    return _Search(most, method, lambda link, quantity: ChangedLink(network, link, quantity).ranges_searched(unstable))


def _along_circle(network: Network, links: Indices, count: int, poles: Complexes, unstable: bool) -> _Search:
    if unstable or not links.size:
        why = "a large scene that is unstable" if unstable else "a large scene with many links and no hand"
        return _Search(0, f"none was worked out for {why}", lambda _link, _quantity: ())
    factors, method = margins_along_circle(network, links, poles)
    of_link = dict(zip(links.tolist(), factors.tolist(), strict=True))
    some = f"{links.size} of {count} links, those that touch a hand; " if links.size < count else ""
    return _Search(links.size, some + method, lambda link, quantity: ((1.0, of_link[link][quantity]),))


def _collected(
    network: Network, links: Indices, found: dict[tuple[int, int], tuple[Range, ...] | None], unstable: bool
) -> Margins:
    """Returns the margins. ``links``: all with margins; ``found``: their ranges, None if a factor changes nothing."""
    nothing = 0.0 if unstable else math.inf
    factors = np.full((link_count(network), 2), nothing)
    factors[links] = math.nan
    stabilizing: list[list[tuple[Range, ...] | None]] = [[(), ()] for _ in factors]
    for link in links.tolist():
        stabilizing[link] = [None, None]
    for (link, quantity), ranges in found.items():
        factors[link, quantity] = nothing
        stabilizing[link][quantity] = ranges or ()
        if ranges is not None:
            below = max((most for _, most in ranges if most <= 1.0), default=0.0)
            factors[link, quantity] = below if unstable else ranges[0][1]
    margins = [Margin(*pair) for pair in factors.tolist()]
    return Margins(margins, "", [Stabilizing(*of_link) for of_link in stabilizing] if unstable else [])


class ChangedLink:
    """Link of a network whose stiffness (``quantity`` 0) or damping (1) is multiplied by a factor. The range of a
    stable loop is the one around 1, up to its upper end. Those of an unstable loop are the nearest below 1 and the
    nearest above 1 in which it becomes stable."""

    def __init__(self, network: Network, link: int, quantity: int) -> None:
        self._network, self._rows = network, rows_of(network, link)
        self._name = ("stiffness", "damping")[quantity]

    @property
    def row(self) -> int:
        """First of the link's rows that has the quantity."""
        return int(self._rows[getattr(self._network, self._name)[self._rows] != 0.0][0])

    def is_stable(self, factor: float) -> bool:
        """Returns whether no pole is outside the circle with that factor; False if the loop's matrix is not finite."""
        value = getattr(self._network, self._name).copy()
        value[self._rows] *= factor
        changed, change = worst_loop(replace(self._network, **{self._name: value}))
        if not np.isfinite(change).all():
            return False
        poles = np.asarray(1.0 + np.linalg.eigvals(change), complex)
        if SURELY < np.abs(poles).max(initial=0.0) < SURELY_OUTSIDE:
            poles = settled(changed, change, poles)
        return bool(np.abs(poles).max(initial=0.0) <= SURELY)

    def ranges_between(self, crossings: Floats, unstable: bool) -> tuple[Range, ...]:
        """Returns the ranges from one test between each two crossings, where stability does not change. If a test
        contradicts the verdict at 1, the ranges are searched by the poles alone."""
        up = [1.0, *_distinct(crossings[crossings > 1.0 + SAME]), math.inf]
        down = [1.0, *_distinct(crossings[crossings < 1.0 - SAME][::-1]), 0.0]
        if self.is_stable(_between(*up[:2])) == unstable:
            return self.ranges_searched(unstable)
        found = [self._first([_between(*pair) for pair in pairwise(up[1:])], up[1:].__getitem__, unstable, math.inf)]
        if unstable:
            found.insert(0, self._first([_between(*pair) for pair in pairwise(down)], down.__getitem__, True, 0.0))
        return tuple(one for one in found if one is not None)

    def ranges_searched(self, unstable: bool) -> tuple[Range, ...]:
        """Returns the ranges from the poles alone: steps outward from 1, and bisection."""
        found = []
        for tests, end in ((1.0 / STEPS, 0.0), (STEPS, math.inf)) if unstable else ((STEPS, math.inf),):
            factors = [1.0, *tests.tolist()]
            found.append(
                self._first(factors[1:], lambda i, at=factors: self._edge(at[i], at[i + 1]), unstable, end)  # type: ignore[misc]
            )
        return tuple(one for one in found if one is not None)

    def _first(self, tests: Sequence[float], edge: Callable[[int], float], unstable: bool, end: float) -> Range | None:
        """Returns the first stable range along factors that lead away from 1 to ``end``; ``edge`` (i): factor at which
        stability changes between the test before i and test i."""
        near = None if unstable else 1.0
        for i, factor in enumerate(tests):
            stable = self.is_stable(factor)
            if near is None and stable:
                near = edge(i)
            elif near is not None and not stable:
                end = edge(i)
                break
        return None if near is None else (min(near, end), max(near, end))

    def _edge(self, one: float, other: float) -> float:
        """Returns the factor between the two at which stability changes, on the stable side, by bisection."""
        stable, unstable = (one, other) if self.is_stable(one) else (other, one)
        while abs(stable / unstable - 1.0) > SAME:
            middle = math.sqrt(stable * unstable)
            stable, unstable = (middle, unstable) if self.is_stable(middle) else (stable, middle)
        return stable


def _distinct(factors: Floats) -> list[float]:
    """Returns sorted factors without those that equal the one before."""
    return [float(one) for i, one in enumerate(factors) if not i or abs(one / factors[i - 1] - 1.0) > SAME]


def _between(one: float, other: float) -> float:
    """Returns a factor inside the range."""
    low, high = sorted((one, other))
    if math.isinf(high):
        return 3.0 * low
    return math.sqrt(low * high) if low else 0.5 * high
