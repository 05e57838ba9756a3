"""Why there is no answer, in words: for whoever sees a NaN."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Complexes

NOT_FINITE = "a number that is asked about is not finite, or beyond what can be worked out"
NEGATIVE = "the slowest motion changes its sign with every sample, which no spring and damper does"
SINGLE = "the slowest motion is a single creep, and what follows it swings: no spring and damper does both"
FURTHER = "a further pole of the loop decays no faster than the pair that would move the hand"
ABOVE_NYQUIST = "the motion asked for swings at or above the Nyquist frequency, half the rate"
OWN_ABOVE_NYQUIST = "mass and spring of the device swing by themselves at or above the Nyquist frequency, half the rate"
LATE = "with these stiffness and damping a further pole of the loop decays no faster than the motion asked for"


def why_not_dominant(poles: Complexes, dominant: Bools) -> NDArray[np.str_]:
    """For poles (..., N) by decreasing modulus; "" where the pair is dominant."""
    first, second = poles[..., 0], poles[..., 1]
    real = first.imag == 0.0
    conjugates = ~real & (second == first.conj())
    cases = [
        (dominant, ""),
        (~np.isfinite(poles).all(axis=-1), NOT_FINITE),
        (conjugates, FURTHER),
        (real & (first.real <= 0.0), NEGATIVE),
        (real & (second.imag == 0.0) & (second.real > 0.0), FURTHER),
        (real, SINGLE),
    ]
    return np.select([case for case, _ in cases], [words for _, words in cases], FURTHER)


def why_not_attained(had: tuple[Bools, Bools], finite: Bools, below_nyquist: Bools) -> NDArray[np.str_]:
    """``had``: whether there is an answer, and whether there would be one if further poles did not count."""
    cases = [(had[0], ""), (~finite, NOT_FINITE), (~below_nyquist, ABOVE_NYQUIST), (had[1], LATE)]
    return np.select([np.asarray(case) for case, _ in cases], [words for _, words in cases], NOT_FINITE)
