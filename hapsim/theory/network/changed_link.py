"""The poles of a loop with one link's stiffness, or damping, multiplied; and between which factors it is stable."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.modes import SURELY, settled
from hapsim.theory.network.network import Network
from hapsim.theory.sample import loop

FURTHER_THAN_ROUNDING = 1.001  # a pole outside of this radius is unstable, whatever rounding does
SAME = 1e-9  # two factors closer than this are one
STEPS = 10.0 ** np.concatenate([np.arange(0.04, 1.0, 0.04), np.arange(1.0, 10.0, 0.3)])  # of a search, from 1 on

Range = tuple[float, float]
"""Of factors: from, to."""


class ChangedLink:
    """A link of a network whose stiffness (``quantity`` 0) or damping (1) is multiplied by a factor.

    A range of a stable loop is that about 1, as far as it goes up. Those of an unstable one are the nearest below 1 and
    the nearest above 1 in which it becomes stable.
    """

    def __init__(self, network: Network, link: int, quantity: int) -> None:
        self._network, self._link = network, link
        self._name = ("stiffness", "damping")[quantity]

    def is_stable(self, factor: float) -> bool:
        """Whether no pole is outside of the circle with that factor; not where the loop's matrix is not finite."""
        value = getattr(self._network, self._name).copy()
        value[self._link] *= factor
        changed = replace(self._network, **{self._name: value})
        change = loop(changed).change
        if not np.isfinite(change).all():
            return False
        poles = np.asarray(1.0 + np.linalg.eigvals(change), complex)
        if SURELY < np.abs(poles).max(initial=0.0) < FURTHER_THAN_ROUNDING:
            poles = settled(changed, change, poles)
        return bool(np.abs(poles).max(initial=0.0) <= SURELY)

    def ranges_between(self, crossings: Floats, unstable: bool) -> tuple[Range, ...]:
        """The ranges by one look between each two crossings, where stability does not change.

        Where a look contradicts the verdict at 1 the ranges are searched by the poles alone.
        """
        up = [1.0, *_apart(crossings[crossings > 1.0 + SAME]), math.inf]
        down = [1.0, *_apart(crossings[crossings < 1.0 - SAME][::-1]), 0.0]
        if self.is_stable(_between(*up[:2])) == unstable:
            return self.ranges_searched(unstable)
        found = [self._first([_between(*pair) for pair in pairwise(up[1:])], up[1:].__getitem__, unstable, math.inf)]
        if unstable:
            found.insert(0, self._first([_between(*pair) for pair in pairwise(down)], down.__getitem__, True, 0.0))
        return tuple(one for one in found if one is not None)

    def ranges_searched(self, unstable: bool) -> tuple[Range, ...]:
        """The ranges by the poles alone: steps outward from 1, and bisection."""
        found = []
        for looks, end in ((1.0 / STEPS, 0.0), (STEPS, math.inf)) if unstable else ((STEPS, math.inf),):
            factors = [1.0, *looks.tolist()]
            found.append(
                self._first(factors[1:], lambda i, at=factors: self._edge(at[i], at[i + 1]), unstable, end)  # type: ignore[misc]
            )
        return tuple(one for one in found if one is not None)

    def _first(self, looks: Sequence[float], edge: Callable[[int], float], unstable: bool, end: float) -> Range | None:
        """The first stable range along factors that lead away from 1 to ``end``; ``edge`` (i): where stability changes
        between the look before i and look i."""
        near = None if unstable else 1.0
        for i, factor in enumerate(looks):
            stable = self.is_stable(factor)
            if near is None and stable:
                near = edge(i)
            elif near is not None and not stable:
                end = edge(i)
                break
        return None if near is None else (min(near, end), max(near, end))

    def _edge(self, one: float, other: float) -> float:
        """Where stability changes between two factors, to the stable side, by bisection."""
        stable, unstable = (one, other) if self.is_stable(one) else (other, one)
        while abs(stable / unstable - 1.0) > SAME:
            middle = math.sqrt(stable * unstable)
            stable, unstable = (middle, unstable) if self.is_stable(middle) else (stable, middle)
        return stable


def _apart(factors: Floats) -> list[float]:
    """Sorted factors without those that are one with the one before."""
    return [float(one) for i, one in enumerate(factors) if not i or abs(one / factors[i - 1] - 1.0) > SAME]


def _between(one: float, other: float) -> float:
    """A factor inside of the range."""
    low, high = sorted((one, other))
    if math.isinf(high):
        return 3.0 * low
    return math.sqrt(low * high) if low else 0.5 * high
