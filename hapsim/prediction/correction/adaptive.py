"""correction: adaptive. The predictor, for the mass of the temporary hybrid system that is estimated while it runs.

Every mass in the declared span has its force. That of a heavy hand is strong: when the hand releases a light device,
it may be unstable before any estimate can follow. So only forces are used that are stable for every mass in the span,
and the estimate goes no further than the greatest mass that has one. ``loop/adaptive.py`` estimates, and moves between
them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.prediction.correction.element import Element, element_for
from hapsim.prediction.correction.kind import Observer
from hapsim.prediction.correction.predictor import PREDICTOR, predictor_for
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats
from hapsim.theory.correction import PredictedLoop

ADAPTIVE = PREDICTOR._replace(name="adaptive", adapts=True)

ROWS = 48
_TRIED = 9  # masses of the span at which each row has to be stable
_ON_THE_CIRCLE = 1e-9


class Schedule(NamedTuple):
    """What is simulated for each of ROWS masses, kg, from the least to the most in equal ratios."""

    masses: Floats
    elements: tuple[Element, ...]
    """Those above ``safe`` are the one for it."""
    safe: float
    """kg: the greatest mass whose element is stable for every mass in the span."""

    def settled(self, mass: float) -> Element:
        """What is simulated once the estimate is this mass, in kg: between two of the elements."""
        made_for = min(mass, self.safe)
        at = np.log(made_for / self.masses[0])
        logs = np.log(self.masses / self.masses[0])
        values = [[one.stiffness, one.damping, one.made_for, *one.observer[:2]] for one in self.elements]
        K, B, model, pole, compliance = (float(np.interp(at, logs, column)) for column in np.transpose(values))
        is_free = self.elements[0].reached
        observer = self.elements[0].observer._replace(pole=pole, compliance=compliance)
        return Element(K, B, made_for if is_free else model, is_free and mass <= self.safe, observer)


def schedule_for(
    declared: Configuration,
    span: tuple[float, float],
    desired: tuple[float, float],
    touched: Sequence[tuple[float, float]] = (),
    observed: Callable[[Configuration, Element], Observer] | None = None,
) -> Schedule:
    """The schedule with which a hand of any mass of the span feels ``desired`` (k in N/m, b in N·s/m).

    Where even the element of the least mass is not stable for all: the one that `element_for` finds for the span.
    ``touched``: (K, B) of contacts, each of which has to leave an element stable. ``observed``: makes the observer that
    an element has in place of its own.
    """
    masses = np.geomspace(*span, ROWS)
    trues = tuple(replace(declared, mass=mass) for mass in np.geomspace(*span, _TRIED).tolist())
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
