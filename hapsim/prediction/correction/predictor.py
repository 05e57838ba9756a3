"""correction: predictor. The links at the device answer the state that the mass will have when their force acts.

The loop of a mass that is the declared one is then that of a device without delay which senses its velocity (Florens
et al., §6.3, ask for the sensor; ``theory/correction`` says what takes its place): both of its poles can be placed
wherever a mass may swing below half the rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from hapsim.prediction.correction.kind import ClosedLoop, CorrectionKind, Observer
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats
from hapsim.theory.correction import SLOWEST, PredictedLoop, StatePredictor, state_predictor

POLES_OF_THE_PUSH = (SLOWEST, 0.25, 0.0)
"""One of these is the observer's: few, so that a scene that changes a little keeps its observer."""


def without_delay(declared: Configuration) -> Configuration:
    """As a mass that is the declared one sees the loop."""
    return replace(declared, delay=0.0, sampling="ideal", damper="sensed", cutoff=None, spring_lag=0.0)


def predicted(true: Configuration, declared: Configuration, observer: Observer) -> ClosedLoop:
    """The loop of a mass that may be another than the declared one."""
    return PredictedLoop(true, predictor_for(declared, observer), observer.static)


def predictor_for(declared: Configuration, observer: Observer) -> StatePredictor:
    """What the loop runs."""
    return state_predictor(declared, observer.senses, observer.pole).for_compliance(observer.compliance)


def observer_of(declared: Configuration, given: Sequence[tuple[tuple[float, float], tuple[float, float]]]) -> Observer:
    """The observer for some desired (k, b), what is real included, each with its simulated (K, B), 0 where not known
    yet. Its poles decay at least twice as fast as the fastest of the desired ones.

    K, of a sampled and held motion, is not k. With the compliance a steady push meets k all the same. Of several it is
    the smallest, the stiffest's: with that of a soft spring a contact beside it would answer a push many times over.
    """
    pole = min((float(pole_of_push(declared, k, b)) for (k, b), _ in given), default=SLOWEST)
    rest, found = state_predictor(declared).at_rest(), []
    for (k, _), (K, B) in given:
        if k > declared.stiffness and K > 0.0:
            x, v, push = rest @ [1.0, declared.stiffness - k]
            found.append((k - declared.stiffness - K * x - B * v) / (K * push))
    return Observer(pole, min(found, key=abs, default=0.0))


def pole_of_push(declared: Configuration, k: ArrayLike, b: ArrayLike) -> Floats:
    """(...): the greatest of `POLES_OF_THE_PUSH` that decays twice as fast as either pole of the mass on (k, b)."""
    k, b = np.asarray(k, float), np.asarray(b, float)
    decay = b + np.sqrt(np.maximum(b * b - 4.0 * k * declared.mass, 0.0))
    fast = np.exp(-decay / declared.mass * declared.period)
    return np.asarray(np.select([fast >= pole for pole in POLES_OF_THE_PUSH], POLES_OF_THE_PUSH))


PREDICTOR = CorrectionKind(
    name="predictor",
    with_damper="sensed",
    predicts=True,
    adapts=False,
    seen_by_theory=without_delay,
    closed=predicted,
)
