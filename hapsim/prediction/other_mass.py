"""With which mass in place of the declared one a hand would swing as it was seen to."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hapsim.prediction.types import Felt
from hapsim.theory import frequency_and_ratio
from hapsim.theory.correction import PredictedLoop

_SPAN, _TRIED = 10.0, 81  # masses from a tenth to ten times the one that is taken for true


def oscillation_at(felt: Felt, mass: float) -> tuple[float, float]:
    """(eigenfrequency in Hz, damping ratio) of this hand where its true mass is `mass` kg, while links and predictor
    stay as they were made for the other; NaN where no spring and damper is equivalent."""
    device = replace(felt.configuration, mass=mass)
    loop = device if felt.predictor is None else PredictedLoop(device, felt.predictor)
    k, b = (float(value) for value in loop.equivalent(felt.stiffness, felt.damping))
    if not k > 0.0:
        return math.nan, math.nan
    frequency, ratio = frequency_and_ratio(mass, k, b)
    return float(frequency), float(ratio)


def masses_with(felt: Felt, frequency_hz: float) -> Iterator[float]:
    """Every mass, kg, within a factor of ten with which the eigenfrequency is this one."""
    from scipy.optimize import brentq

    def off(mass: float) -> float:
        return oscillation_at(felt, mass)[0] - frequency_hz

    tried = felt.configuration.mass * np.geomspace(1.0 / _SPAN, _SPAN, _TRIED)
    errors = [off(mass) for mass in tried.tolist()]
    for i in range(_TRIED - 1):
        if errors[i] * errors[i + 1] <= 0.0:  # not where one of them is NaN
            try:
                yield float(brentq(off, tried[i], tried[i + 1], xtol=1e-15, rtol=1e-12))
            except ValueError:  # NaN in between
                continue
