"""The simulated (K, B) of a hand whose links all end on grounds: the one that is felt as desired, or comes nearest."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.prediction.correction.kind import ClosedLoop, CorrectionKind, Observer
from hapsim.prediction.correction.predictor import observer_of
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats

LEAST_DAMPING = 0.1
"""An error of b counts against b, or against this part of the critical damping's half where b is smaller."""

_UNSTABLE, _NO_EQUIVALENT = 1e6, 1e3  # costs above every error that counts
_GRID, _LEAST_GRID, _ZOOMS, _KEPT = 41, 9, 7, 0.15
_WORK = 3e4  # points of a grid, times loops, times the cube of a sixth of the poles: fewer where the delay is long
_MASSES = 5  # of a span, at which the worst error is looked for
_AT_THE_LIMIT = 1e-9


class Element(NamedTuple):
    """What the daemon simulates in place of a (K, B)."""

    stiffness: float
    """K, N/m"""
    damping: float
    """B, N·s/m"""
    made_for: float
    """kg: the mass that a predictor takes the hand for."""
    reached: bool
    """Whether what is felt is what is desired, for every mass that there may be."""
    observer: Observer = Observer()
    """Of a predictor."""


def element_for(
    kind: CorrectionKind, declared: Configuration, span: tuple[float, float], desired: tuple[float, float]
) -> Element:
    """The element that is felt as ``desired`` (k in N/m, b in N·s/m, what is real included), or nearest to it.

    ``declared``: the device, its delay and damper included. ``span``: the least and the most mass in kg; where the two
    differ, the worst error over the span is made as small as it can be. A predictor is then made for the least: one
    that takes the hand for heavier than it is loses its stability first.
    """
    least, most = span
    spring = desired[0] - declared.stiffness
    model = replace(declared, mass=least if kind.predicts and least < most else declared.mass)
    observer = observer_of(model, [(desired, (0.0, 0.0))])._replace(static=spring if spring > 0.0 else None)
    reached, masses = False, [declared.mass]
    K, B = math.nan, math.nan
    if least == most:
        K, B = (float(value) for value in kind.seen_by_theory(declared).simulated(*desired))
        reached = math.isfinite(K) and math.isfinite(B)
    else:
        masses = np.geomspace(least, most, _MASSES).tolist()
    if not reached:
        loops = [kind.closed(replace(declared, mass=mass), model, observer) for mass in masses]
        K, B = _nearest(loops, masses, declared, desired)
    return Element(K, B, model.mass, reached, observer_of(model, [(desired, (K, B))]))


def felt_error(
    felt: tuple[Floats, Floats], desired: tuple[float | Floats, float | Floats], mass: float | Floats
) -> Floats:
    """How far the felt (k, b) is from the desired one: the larger of the relative errors of the two; infinite where
    there is no felt one. Of b, relative to the desired one or to 0.1 sqrt(k m), whichever is larger; of k, where
    none is desired, relative to b²/m."""
    (k, b), (k_wanted, b_wanted) = felt, desired
    critical = np.sqrt(np.abs(k_wanted) * mass)
    with np.errstate(all="ignore"):
        of_k = np.abs(k - k_wanted) / np.where(k_wanted, np.abs(k_wanted), np.square(b_wanted) / mass)
        of_b = np.abs(b - b_wanted) / np.maximum(np.abs(b_wanted), LEAST_DAMPING * critical)
        error = np.maximum(of_k, of_b)
    return np.where(np.isfinite(error), error, np.inf)


def _nearest(
    loops: Sequence[ClosedLoop], masses: Sequence[float], declared: Configuration, desired: tuple[float, float]
) -> tuple[float, float]:
    """(K, B), searched on grids, each finer than the one before, around the best."""
    k, b = desired
    most_K = min(2.0 * max(k, 0.0), 4.0 * declared.stiffness_unit)
    most_B = min(4.0 * max(b, math.sqrt(max(k, 0.0) * declared.mass)), 2.0 * declared.damping_unit)
    lowest, highest = np.zeros(2), np.array([most_K, most_B])
    best, cost = np.zeros(2), math.inf
    poles = loops[0].poles(0.0, 0.0).shape[-1]
    size = int(np.clip(math.sqrt(_WORK / (len(loops) * (poles / 6.0) ** 3)), _LEAST_GRID, _GRID))
    for _ in range(_ZOOMS):
        K, B = np.meshgrid(*(np.linspace(lowest[i], highest[i], size) for i in range(2)), indexing="ij")
        costs = np.max(
            [_cost(loop, K.ravel(), B.ravel(), desired, mass) for loop, mass in zip(loops, masses, strict=True)], axis=0
        )
        at = int(np.argmin(costs))
        if costs[at] <= cost:
            cost, best = float(costs[at]), np.array([K.flat[at], B.flat[at]])
        half = _KEPT * (highest - lowest)
        lowest, highest = np.maximum(best - half, 0.0), best + half
    return float(best[0]), float(best[1])


def _cost(loop: ClosedLoop, K: Floats, B: Floats, desired: tuple[float, float], mass: float) -> Floats:
    """The error; a loop without an equivalent costs more than any that has one, an unstable one more than any."""
    radius = np.abs(loop.poles(K, B)[..., 0])
    cost = _UNSTABLE * radius
    stable = radius <= 1.0 + _AT_THE_LIMIT
    if stable.any():
        error = felt_error(loop.equivalent(K[stable], B[stable]), desired, mass)
        cost[stable] = np.where(np.isfinite(error), error, _NO_EQUIVALENT * radius[stable])
    return np.asarray(cost)
