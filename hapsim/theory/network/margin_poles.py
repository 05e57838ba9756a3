"""A link's gain margin by the poles themselves: those of the loop with that link multiplied."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.modes import settled
from hapsim.theory.network.network import Network, acting_links, touches_channel
from hapsim.theory.network.state import state_size, transition

BESIDE = 1e-3  # the poles are looked at this far below and above a factor
LIMIT = 1.0 + 1e-9  # a pole within it is not unstable: it may rest on 1, or never lose its energy
SEARCHES = 6e8  # what looking for margins may cost: transitions tried times the cube of the state's size
TRIES = 70  # that one search may take
RANGE_TRIES = 4 * TRIES  # that the search for two ranges may take, each with two ends
ONE_AT_LEAST = 200  # numbers in the state of the largest scene of which one link is looked for, whatever it costs

Range = tuple[float, float]
"""Of factors: from, to."""


class ByPoles(NamedTuple):
    """``factors``: (L, 2), of stiffness and damping of each link, those that touch a hand first, as long as time
    allows, the others NaN. ``ranges``: of an unstable loop the same, those that make it stable; None where they were
    not worked out. ``method``: which and how surely, in words."""

    factors: Floats
    ranges: list[list[tuple[Range, ...] | None]]
    method: str


def by_poles(network: Network, unstable: bool) -> ByPoles:
    """The margins of a network by its poles alone."""
    links = acting_links(network)
    links = links[links < (len(network.ends) if network.margin_links is None else network.margin_links)]
    factors = np.full((len(network.ends), 2), 0.0 if unstable else math.inf)
    ranges: list[list[tuple[Range, ...] | None]] = [[(), ()] for _ in network.ends] if unstable else []
    tries = RANGE_TRIES if unstable else TRIES
    affordable = int(SEARCHES / tries / 2 / (state_size(network) + 40) ** 3)
    affordable = max(affordable, int(state_size(network) <= ONE_AT_LEAST))
    order = links[np.argsort(~touches_channel(network, links), kind="stable")]
    factors[order[affordable:]] = math.nan
    for link in order[affordable:].tolist() if unstable else ():
        ranges[link] = [None, None]
    written = np.stack([network.stiffness, network.damping], axis=1)
    for link in order[:affordable].tolist():
        for of in np.flatnonzero(written[link]).tolist():
            varied = Varied(network, link, of)
            if unstable:
                ranges[link][of] = found = varied.stable_ranges()
                factors[link, of] = largest_below(found)
            else:
                factors[link, of] = varied.searched(unstable)
    how = "by the poles, in steps of a tenth, beyond tenfold of double: what comes and goes within one is not seen"
    if order.size and not affordable:
        return ByPoles(
            factors, ranges, f"none was worked out: of so many masses that is not done under scheme: {network.scheme}"
        )
    if order.size > affordable:
        how = f"{affordable} of {order.size} links, those that touch a hand first; {how}"
    return ByPoles(factors, ranges, how if links.size else "")


def largest_below(ranges: tuple[Range, ...]) -> float:
    """The largest factor below 1 in one of them; 0 where there is none."""
    return max((most for _, most in ranges if most <= 1.0), default=0.0)


class Varied:
    """The loop's poles with one link's stiffness (0) or damping (1) multiplied."""

    def __init__(self, network: Network, link: int, of: int) -> None:
        self._network, self._link, self._name = network, link, ("stiffness", "damping")[of]

    def radius(self, factor: float) -> float:
        """The spectral radius with that factor; infinity where the loop's matrix is not finite."""
        value = getattr(self._network, self._name).copy()
        value[self._link] *= factor
        changed = replace(self._network, **{self._name: value})
        matrix = transition(changed)
        if not np.isfinite(matrix).all():
            return math.inf
        poles = np.linalg.eigvals(matrix).astype(complex)
        return float(np.abs(settled(changed, matrix, poles)).max(initial=0.0))

    def agree(self, factor: float, unstable: bool) -> bool:
        """Whether the loop is stable just below the factor, and not well inside the circle just above it."""
        if math.isnan(factor):
            return False
        if factor == 0.0:
            return self.radius(0.5) > 1.0 or self.radius(1e-6) > 1.0
        if factor == math.inf:
            return max(self.radius(1.5), self.radius(30.0)) <= LIMIT
        below, above = factor * (1.0 - BESIDE), factor * (1.0 + BESIDE)
        if not unstable:
            below = max(below, 0.5 * (1.0 + factor))  # the loop as it stands is known to be stable
        return self.radius(below) <= LIMIT and self.radius(above) >= 2.0 - LIMIT

    def is_unstable(self, factor: float) -> bool:
        """Or at the limit."""
        return self.radius(factor) >= 2.0 - LIMIT

    def is_stable_between(self, least: float, most: float) -> bool:
        """Whether the loop is stable in the middle of this range, and no longer just outside it."""
        middle = (math.sqrt(least * most) if math.isfinite(most) else 2.0 * least) or 0.5 * most
        outside = [least * (1.0 - BESIDE)] * (least > 0.0) + [most * (1.0 + BESIDE)] * math.isfinite(most)
        return self.radius(middle) <= LIMIT and all(self.is_unstable(factor) for factor in outside)

    def stable_ranges(self) -> tuple[Range, ...]:
        """Of an unstable loop: the nearest range of factors below 1 in which it is stable, and the nearest above."""
        found = (self._range(list(_outward(downward))) for downward in (True, False))
        return tuple(one for one in found if one is not None)

    def _range(self, factors: list[float]) -> Range | None:
        """The first along these factors, which lead away from 1."""
        near: float | None = None
        for last, factor in pairwise(factors):
            stable = self.radius(factor) <= LIMIT
            if near is None and stable:
                near = self._edge(factor, last)
            elif near is not None and not stable:
                return _ordered(near, self._edge(last, factor))
        return None if near is None else _ordered(near, 0.0 if factors[-1] < 1.0 else math.inf)

    def _edge(self, stable: float, unstable: float) -> float:
        """Bisection, to the stable side."""
        while abs(stable / unstable - 1.0) > 1e-9:
            middle = math.sqrt(stable * unstable)
            stable, unstable = (middle, unstable) if self.radius(middle) <= LIMIT else (stable, middle)
        return stable

    def searched(self, unstable: bool) -> float:
        """Bisection between a stable and an unstable factor."""
        last = None
        for factor in _outward(unstable):
            stable = self.radius(factor) <= LIMIT
            if last is not None and stable == unstable:
                return self._between(*((factor, last) if unstable else (last, factor)))
            last = factor
        return 0.0 if unstable else math.inf

    def _between(self, low: float, high: float) -> float:
        while high / low > 1.0 + 1e-9:
            middle = math.sqrt(low * high)
            low, high = (middle, high) if self.radius(middle) <= LIMIT else (low, middle)
        return low


def _ordered(one: float, other: float) -> Range:
    return (one, other) if one < other else (other, one)


def _outward(unstable: bool) -> Iterator[float]:
    """Factors from 1 on, upward or downward, in growing steps."""
    for step in np.concatenate([np.arange(0.0, 1.0, 0.04), np.arange(1.0, 10.0, 0.3)]):
        yield float(10.0 ** (-step if unstable else step))
