"""Simulated (K, B) of a hand whose links all end on grounds: it feels as desired, or comes nearest to it.

An adaptive correction has one for each mass of a span. That of a heavy hand is strong: when the hand releases a light
device, it may be unstable before any estimate can follow. So only forces are used that are stable for every mass in the
span, and the estimate goes no further than the greatest mass that has one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.prediction.correction.kind import (
    PREDICTOR,
    ClosedLoop,
    CorrectionKind,
    Observer,
    observer_of,
    predictor_for,
)
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats
from hapsim.theory.correction import PredictedLoop
from hapsim.theory.interface import StatePredictor

LEAST_DAMPING = 0.1
"""Least scale of an error of b, as a part of half the critical damping; above it, b itself is the scale."""

_UNSTABLE, _NO_EQUIVALENT = 1e6, 1e3  # costs above every error that counts
_GRID, _LEAST_GRID, _ZOOMS, _KEPT = 41, 9, 7, 0.15
_WORK = 3e4  # points of a grid, times loops, times the cube of a sixth of the poles: fewer if the delay is long
_MASSES = 5  # of a span, at which the worst error is computed
_AT_THE_LIMIT = 1e-9


class Element(NamedTuple):
    """Simulated element in place of a (K, B): N/m and N·s/m. ``made_for``: the mass in kg that a predictor assumes.
    ``reached``: whether the hand feels the desired k and b, with any mass of its span. ``observer``: of a predictor."""

    stiffness: float
    damping: float
    made_for: float
    reached: bool
    observer: Observer = Observer()


@lru_cache(1024)  # run, prediction and warnings of a scene need the same ones
def element_for(
    kind: CorrectionKind, declared: Configuration, span: tuple[float, float], desired: tuple[float, float]
) -> Element:
    """Returns the element that feels like ``desired`` (k in N/m, b in N·s/m, real parts included), or nearest to it.
    ``declared``: the device, its delay and damper included. ``span``: the least and the most mass in kg. Over a span
    the worst error is minimised, and a predictor is made for the least mass: one that assumes a heavier hand than the
    real one loses its stability first."""
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
    """Returns the larger of the relative errors of the felt k and b; infinite if none is felt. That of b is relative to
    the desired b or to 0.1 sqrt(k m), whichever is larger; that of k, if none is desired, to b²/m."""
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
    """Returns (K, B), searched on grids around the best, each finer than the one before."""
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
    """Returns the error; a loop without an equivalent costs more than any with one, an unstable one more than any."""
    poles, *felt = loop.solved(K, B)
    radius = np.abs(poles[..., 0])
    error = felt_error((felt[0], felt[1]), desired, mass)
    cost = np.where(np.isfinite(error), error, _NO_EQUIVALENT * radius)
    cost = np.where(radius <= 1.0 + _AT_THE_LIMIT, cost, _UNSTABLE * radius)
    return np.asarray(cost)


_MOST_RATE = 64.0  # times the scene's
_HALVINGS = 40
_WIDEST, _STEPS = 30.0, 41  # times the mass, to either side
_ON_THE_CIRCLE = 1e-9


class Remedies(NamedTuple):
    """Changes that would make the desired (k, b) felt, each by itself; None if it does not. ``rate_hz``: the least
    rate; the delay keeps its number of samples, and so becomes shorter. ``delay_samples``: the longest delay.
    ``friction``: the least real friction in N·s/m, which supplies part of the desired damping. ``predictor``: whether
    correction: predictor achieves it."""

    rate_hz: float | None
    delay_samples: float | None
    friction: float | None
    predictor: bool


def remedies_for(kind: CorrectionKind, declared: Configuration, desired: tuple[float, float]) -> Remedies:
    """Returns the remedies for the declared device, and (k, b) in N/m and N·s/m, real parts included."""

    def is_had(configuration: Configuration, of: CorrectionKind = kind) -> bool:
        return bool(np.isfinite(of.seen_by_theory(configuration).simulated(*desired)).all())

    rates = declared.rate * np.array([1.0, _MOST_RATE])
    rate = _least(lambda rate: is_had(replace(declared, rate=rate)), *rates)
    delay = _least(lambda less: is_had(replace(declared, delay=declared.delay - less)), 0.0, declared.delay)
    friction = _least(lambda real: is_had(replace(declared, friction=real)), declared.friction, desired[1])
    return Remedies(
        rate_hz=rate and rate / declared.steps,
        delay_samples=None if delay is None or kind.predicts else (declared.delay - delay) / declared.steps,
        friction=friction,
        predictor=not kind.predicts and not declared.spring_lag and declared.steps == 1 and is_had(declared, PREDICTOR),
    )


def stable_masses(
    loop_of: Callable[[Configuration], ClosedLoop], made_for: Configuration, element: tuple[float, float]
) -> tuple[float, float]:
    """Returns the least and greatest mass in kg, around the one that an element (K, B) is made for, at which the loop
    of a configuration is stable. 0 and infinity beyond thirty times to either side. NaN if it is stable at none."""

    def is_stable(mass: float) -> bool:
        poles = loop_of(replace(made_for, mass=mass)).poles(*element)
        return bool(np.abs(poles[..., 0]) <= 1.0 + _ON_THE_CIRCLE)

    if not is_stable(made_for.mass):
        return math.nan, math.nan
    found = []
    for widest, end in ((1.0 / _WIDEST, 0.0), (_WIDEST, math.inf)):
        masses = (made_for.mass * np.geomspace(1.0, widest, _STEPS)).tolist()
        good, bad = next((pair for pair in pairwise(masses) if not is_stable(pair[1])), (end, end))
        found.append(_boundary(is_stable, bad, good, lambda one, other: math.sqrt(one * other)))
    return found[0], found[1]


def _least(holds: Callable[[float], bool], start: float, stop: float) -> float | None:
    """Returns the first number from start to stop at which the condition holds; None if it does not at the stop."""
    if not stop > start or not holds(stop):
        return None
    return _boundary(holds, start, stop, lambda one, other: 0.5 * (one + other))


def _boundary(
    holds: Callable[[float], bool], bad: float, good: float, middle: Callable[[float, float], float]
) -> float:
    """Returns the end of the range between two numbers in which the condition holds, by bisection; the good one if both
    are the same."""
    for _ in range(_HALVINGS if bad != good else 0):
        between = middle(bad, good)
        bad, good = (bad, between) if holds(between) else (between, good)
    return float(good)


ROWS = 48
_SPAN_TRIED = 9  # masses of the span at which each row has to be stable


class Schedule(NamedTuple):
    """Elements for each of ROWS masses, kg, from the least to the most in equal ratios."""

    masses: Floats
    elements: tuple[Element, ...]
    """Elements; those above ``safe`` are the one for it."""
    safe: float
    """Greatest mass whose element is stable for every mass in the span, kg."""

    def settled(self, mass: float) -> Element:
        """Returns the element once the estimate is this mass, in kg: between two of the elements, as in the loop."""
        first, second, share = self._around(mass)
        values = zip(first[:3], second[:3], strict=True)
        K, B, model = (one + share * (other - one) for one, other in values)
        is_free = self.elements[0].reached
        return Element(K, B, min(mass, self.safe) if is_free else model, is_free and mass <= self.safe)

    def predictor(self, declared: Configuration, mass: float) -> StatePredictor:
        """Returns the predictor of that element: the loop takes each of its numbers between those of two elements."""
        first, second, share = self._around(mass)
        one, other = (predictor_for(replace(declared, mass=each.made_for), each.observer) for each in (first, second))
        names = ("step", "reading", "gains", "first", "ahead", "mass")
        return one._replace(**{n: getattr(one, n) + share * (getattr(other, n) - getattr(one, n)) for n in names})

    def _around(self, mass: float) -> tuple[Element, Element, float]:
        """Returns the two elements around a mass, and how far it is from the first to the second."""
        logs = np.log([min(mass, self.safe) / self.masses[0], self.masses[-1] / self.masses[0]])
        share, row = math.modf(max(float(logs[0] / logs[1]), 0.0) * (ROWS - 1))
        return self.elements[int(row)], self.elements[min(int(row) + 1, ROWS - 1)], share


def schedule_for(
    declared: Configuration,
    span: tuple[float, float],
    desired: tuple[float, float],
    touched: Sequence[tuple[float, float]] = (),
    observed: Callable[[Configuration, Element], Observer] | None = None,
) -> Schedule:
    """Returns the schedule with which a hand of any mass of the span feels ``desired`` (k in N/m, b in N·s/m). If even
    the element of the least mass is not stable for all: the one that `element_for` finds for the span. ``touched``: (K,
    B) of contacts, each of which has to leave an element stable. ``observed``: makes the observer of an element in
    place of its own."""
    masses = np.geomspace(*span, ROWS)
    trues = tuple(replace(declared, mass=mass) for mass in np.geomspace(*span, _SPAN_TRIED).tolist())
    found: list[Element] = []
    for mass in masses.tolist():
        model = replace(declared, mass=mass)
        element = element_for(PREDICTOR, model, (mass, mass), desired)
        if observed is not None:
            element = element._replace(observer=observed(model, element))
        sums = [(element.stiffness + K, element.damping + B) for K, B in [(0.0, 0.0), *touched]]
        if not element.reached or not all(_is_stable_for(trues, model, element.observer, K, B) for K, B in sums):
            break
        found.append(element)
    if not found:
        element = element_for(PREDICTOR, declared, span, desired)
        model = replace(declared, mass=element.made_for)
        found.append(element if observed is None else element._replace(observer=observed(model, element)))
    elements = found + [found[-1]] * (ROWS - len(found))
    return Schedule(masses, tuple(elements), float(masses[len(found) - 1]))


@lru_cache(1024)
def _is_stable_for(
    trues: tuple[Configuration, ...], model: Configuration, observer: Observer, K: float, B: float
) -> bool:
    predictor = predictor_for(model, observer)
    loops = (PredictedLoop(true, predictor) for true in trues)
    return all(bool(np.abs(loop.poles(K, B)[..., 0]) <= 1.0 + _ON_THE_CIRCLE) for loop in loops)
