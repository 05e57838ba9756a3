"""The holds and the samplings there are, by the names that a scene file uses; and how a delay is split."""

from __future__ import annotations

import math

from hapsim.theory.hold_impulse import IMPULSE
from hapsim.theory.hold_zoh import ZERO_ORDER_HOLD
from hapsim.theory.sampling_average import AVERAGE
from hapsim.theory.sampling_ideal import IDEAL
from hapsim.theory.shape import Hold, Sampling

HOLDS: dict[str, Hold] = {"zoh": ZERO_ORDER_HOLD, "impulse": IMPULSE}
SAMPLINGS: dict[str, Sampling] = {"ideal": IDEAL, "average": AVERAGE}


def whole_and_fraction(delay: float) -> tuple[int, float]:
    """A delay in sample periods as whole samples and the fraction of one, 0 <= fraction < 1."""
    whole = math.floor(delay)
    return whole, delay - whole
