"""Numbers for a reader: steps of 1, 2 or 5 times a power of ten, and how a number is written."""

from __future__ import annotations

import math

import numpy as np

from hapsim.theory.arrays import Floats


def round_step(range_: float, most: int) -> float:
    """The smallest round step that divides a range into no more than `most` parts; NaN where there is no range."""
    if not 0.0 < range_ < math.inf:
        return math.nan
    decade = 10.0 ** math.floor(math.log10(range_ / most))
    return next(step * decade for step in (1.0, 2.0, 5.0, 10.0, 20.0) if step * decade * most >= range_ * (1 - 1e-9))


def round_values(last: float, most: int) -> Floats:
    """Multiples of a round step from the step itself up to `last`, at most `most` of them."""
    step = round_step(last, most)
    if math.isnan(step):
        return np.empty(0)
    count = math.floor(last / step * (1.0 + 1e-9))
    return np.array([float(f"{step * (i + 1):.10g}") for i in range(count)])


def round_up(value: float) -> float:
    """The next number of two digits, so that an axis does not end anywhere."""
    if not 0.0 < value < math.inf:
        return value
    decade = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / decade * (1 - 1e-9)) * decade:.10g}")


def short(value: float) -> str:
    """A number for a picture, with four digits."""
    digits = 4 if abs(value) < 1e4 else 5 if abs(value) < 1e5 else 6 if abs(value) < 1e6 else 4
    words = f"{value:.{digits}g}"
    return words.replace("e+0", "e").replace("e+", "e").replace("e-0", "e-").replace("-", "−")
