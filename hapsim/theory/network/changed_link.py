"""The poles of a loop with one link's stiffness, or damping, multiplied; and between which factors it is stable."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.modes import settled
from hapsim.theory.network.network import Network
from hapsim.theory.network.state import transition

LIMIT = 1.0 + 1e-9  # a pole within it is not unstable: it may rest on 1, or never lose its energy
FURTHER_THAN_ROUNDING = 1.001  # a pole outside of this radius is unstable, whatever rounding does
SAME = 1e-9  # two factors closer than this are one

Range = tuple[float, float]
"""Of factors: from, to."""


class ChangedLink:
    """A link of a network whose stiffness (``quantity`` 0) or damping (1) is multiplied by a factor."""

    def __init__(self, network: Network, link: int, quantity: int) -> None:
        self._network, self.link, self.quantity = network, link, quantity

    def radius(self, factor: float) -> float:
        """The spectral radius with that factor; infinity where the loop's matrix is not finite."""
        name = ("stiffness", "damping")[self.quantity]
        value = getattr(self._network, name).copy()
        value[self.link] *= factor
        changed = replace(self._network, **{name: value})
        matrix = transition(changed)
        if not np.isfinite(matrix).all():
            return math.inf
        poles = np.linalg.eigvals(matrix).astype(complex)
        radius = float(np.abs(poles).max(initial=0.0))
        if not LIMIT < radius < FURTHER_THAN_ROUNDING:
            return radius
        return float(np.abs(settled(changed, matrix, poles)).max(initial=0.0))

    def is_stable(self, factor: float) -> bool:
        """Whether no pole is outside of the circle with that factor."""
        return self.radius(factor) <= LIMIT

    def ranges_between(self, crossings: Floats, unstable: bool) -> tuple[Range, ...]:
        """The range of factors about 1 in which a stable loop stays stable, as far as it goes up; or the nearest below
        1 and above 1 in which an unstable one becomes stable.

        Between two crossings stability does not change: one look at the poles there tells. Where a look contradicts
        what is known at 1 the range is searched by the poles alone.
        """
        up = [1.0, *_apart(crossings[crossings > 1.0 + SAME]), math.inf]
        if self.is_stable(_between(*up[:2])) == unstable:
            return self.ranges_searched(unstable)
        if not unstable:
            ends = (low for low, high in pairwise(up[1:]) if not self.is_stable(_between(low, high)))
            return ((1.0, next(ends, math.inf)),)
        down = [1.0, *_apart(crossings[crossings < 1.0 - SAME])[::-1], 0.0]
        found = (self._first_range(edges) for edges in (down, up))
        return tuple(one for one in found if one is not None)

    def _first_range(self, edges: list[float]) -> Range | None:
        """The first stable one along these edges, which lead away from 1."""
        near: float | None = None
        for last, edge in pairwise(edges):
            stable = self.is_stable(_between(*sorted((last, edge))))
            if stable and near is None:
                near = last
            elif near is not None and not stable:
                return _ordered(near, last)
        return None if near is None else _ordered(near, edges[-1])

    def ranges_searched(self, unstable: bool) -> tuple[Range, ...]:
        """The same by the poles alone: steps outward from 1, and bisection."""
        if not unstable:
            last = 1.0
            for factor in _outward(False):
                if not self.is_stable(factor):
                    return ((1.0, self._edge(last, factor)),)
                last = factor
            return ((1.0, math.inf),)
        found = (self._searched(list(_outward(downward))) for downward in (True, False))
        return tuple(one for one in found if one is not None)

    def _searched(self, factors: list[float]) -> Range | None:
        """The first stable range along these factors, which lead away from 1."""
        near: float | None = None
        for last, factor in pairwise(factors):
            stable = self.is_stable(factor)
            if near is None and stable:
                near = self._edge(factor, last)
            elif near is not None and not stable:
                return _ordered(near, self._edge(last, factor))
        return None if near is None else _ordered(near, 0.0 if factors[-1] < 1.0 else math.inf)

    def _edge(self, stable: float, unstable: float) -> float:
        """Bisection, to the stable side."""
        while abs(stable / unstable - 1.0) > SAME:
            middle = math.sqrt(stable * unstable)
            stable, unstable = (middle, unstable) if self.is_stable(middle) else (stable, middle)
        return stable


def _apart(ascending: Floats) -> list[float]:
    """Without those that are one with the one before."""
    return [float(one) for i, one in enumerate(ascending) if not i or one > ascending[i - 1] * (1.0 + SAME)]


def _between(low: float, high: float) -> float:
    """A factor inside of the range."""
    if math.isinf(high):
        return 3.0 * low
    return math.sqrt(low * high) if low else 0.5 * high


def _ordered(one: float, other: float) -> Range:
    return (one, other) if one < other else (other, one)


def _outward(downward: bool) -> Iterator[float]:
    """Factors from 1 on, in growing steps."""
    for step in np.concatenate([np.arange(0.0, 1.0, 0.04), np.arange(1.0, 10.0, 0.3)]):
        yield float(10.0 ** (-step if downward else step))
