"""correction: predictor. The links at the device answer the state that the mass will have when their force acts.

The loop of a mass that is the declared one is then that of a device without delay which senses its velocity (Florens
et al., §6.3, ask for the sensor; ``theory/correction`` says what takes its place): both of its poles can be placed
wherever a mass may swing below half the rate.
"""

from __future__ import annotations

from dataclasses import replace

from hapsim.prediction.correction.kind import ClosedLoop, CorrectionKind
from hapsim.theory import Configuration
from hapsim.theory.correction import PredictedLoop, state_predictor


def without_delay(declared: Configuration) -> Configuration:
    """As a mass that is the declared one sees the loop."""
    return replace(declared, delay=0.0, sampling="ideal", damper="sensed", cutoff=None)


def predicted(true: Configuration, declared: Configuration) -> ClosedLoop:
    """The loop of a mass that may be another than the declared one."""
    return PredictedLoop(true, state_predictor(declared))


PREDICTOR = CorrectionKind(
    name="predictor",
    with_damper="sensed",
    predicts=True,
    adapts=False,
    seen_by_theory=without_delay,
    closed=predicted,
)
