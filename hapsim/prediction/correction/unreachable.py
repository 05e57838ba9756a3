"""A desired (k, b) that cannot be had: what would make it so; and the masses at which a correction keeps its stability.

All of it is asked of the closed forms again, once for every number that is tried.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from hapsim.prediction.correction.kind import ClosedLoop, CorrectionKind
from hapsim.prediction.correction.predictor import PREDICTOR
from hapsim.theory import Configuration

_MOST_RATE = 64.0  # times the scene's
_HALVINGS = 40
_WIDEST, _STEPS = 30.0, 41  # times the mass, to either side
_ON_THE_CIRCLE = 1e-9


class Remedies(NamedTuple):
    """What would make the desired (k, b) felt, everything else as it is; None where that alone does not.

    The delay keeps its number of samples where the rate goes up, so that it becomes shorter in seconds. Real friction
    takes its part of the desired damping; the scene's goes down by as much.
    """

    rate_hz: float | None
    """from this rate on"""
    delay_samples: float | None
    """up to this delay"""
    friction: float | None
    """N·s/m: from this real friction of the device on"""
    predictor: bool
    """whether correction: predictor does it"""


def remedies_for(kind: CorrectionKind, declared: Configuration, desired: tuple[float, float]) -> Remedies:
    """For the device as declared, and (k, b) in N/m and N·s/m, what is real included."""

    def is_had(configuration: Configuration, of: CorrectionKind = kind) -> bool:
        return bool(np.isfinite(of.seen_by_theory(configuration).simulated(*desired)).all())

    rates = declared.rate * np.array([1.0, _MOST_RATE])
    rate = _least(lambda rate: is_had(replace(declared, rate=rate)), *rates)
    delay = _least(lambda less: is_had(replace(declared, delay=declared.delay - less)), 0.0, declared.delay)
    friction = _least(lambda real: is_had(replace(declared, friction=real)), declared.friction, desired[1])
    return Remedies(
        rate_hz=rate,
        delay_samples=None if delay is None or kind.predicts else declared.delay - delay,
        friction=friction,
        predictor=not kind.predicts and is_had(declared, PREDICTOR),
    )


def stable_masses(
    loop_of: Callable[[Configuration], ClosedLoop], made_for: Configuration, element: tuple[float, float]
) -> tuple[float, float]:
    """The least and the most mass in kg, around the one that an element (K, B) is made for, at which the loop of a
    configuration is stable: 0 and infinity where it is down, or up, to thirty times. NaN where it is at none."""

    def is_stable(mass: float) -> bool:
        poles = loop_of(replace(made_for, mass=mass)).poles(*element)
        return bool(np.abs(poles[..., 0]) <= 1.0 + _ON_THE_CIRCLE)

    if not is_stable(made_for.mass):
        return math.nan, math.nan
    lighter, heavier = np.geomspace(1.0, 1.0 / _WIDEST, _STEPS), np.geomspace(1.0, _WIDEST, _STEPS)
    found = [_last(is_stable, made_for.mass * factors) for factors in (lighter, heavier)]
    return (0.0 if found[0] is None else found[0], math.inf if found[1] is None else found[1])


def _least(holds: Callable[[float], bool], start: float, stop: float) -> float | None:
    """Where, from the start to the stop, it begins to hold; None where it does not at the stop."""
    if not stop > start or not holds(stop):
        return None
    for _ in range(_HALVINGS):
        middle = 0.5 * (start + stop)
        start, stop = (start, middle) if holds(middle) else (middle, stop)
    return stop


def _last(holds: Callable[[float], bool], tried: np.ndarray) -> float | None:
    """Up to where it holds, of numbers from the first on; None where it holds at all."""
    values = tried.tolist()
    at = next((i for i, value in enumerate(values) if not holds(value)), None)
    if at is None:
        return None
    good, bad = values[at - 1], values[at]
    for _ in range(_HALVINGS):
        middle = math.sqrt(good * bad)
        good, bad = (middle, bad) if holds(middle) else (good, middle)
    return float(good)
