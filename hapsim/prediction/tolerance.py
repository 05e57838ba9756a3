"""How well a device has to be known for a correction: within which mass, friction and delay the hand feels what is
desired."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from hapsim.prediction.felt import Felt
from hapsim.theory import Configuration

SHARES = (0.05, 0.1)
"""By which k and b may be off."""
_STEP = 0.02  # of the mass, of b, and of a sample: what is desired may be met again further away, which does not count
_LONGER = 1.3  # times the one before, each step, up to
_LONGEST = 0.1
_MOST = 100.0  # steps: what they do not leave is as good as any
_HALVINGS = 16


class Tolerance(NamedTuple):
    """The least and the most of each with which k and b stay within a share of what is desired, and the loop stable;
    infinite where e^10 times the mass, ten times b, or ten samples more do not leave it."""

    share: float
    mass: tuple[float, float]
    """kg."""
    friction: tuple[float, float]
    """N·s/m."""
    delay: tuple[float, float]
    """Sample periods."""


def tolerance_of(felt: Felt, k: float, b: float, share: float) -> Tolerance | None:
    """Of a hand that is to feel k and b (N/m, N·s/m); None where it does not, with the device as it is declared.

    One of the three is varied at a time, for what was made for the declared ones.
    """
    device = felt.configuration

    def meets(other: Configuration) -> bool:
        try:
            found = replace(felt, configuration=other)
            return found.stable and abs(found.k - k) <= share * k and abs(found.b - b) <= share * b
        except (ValueError, ArithmeticError):
            return False

    if not meets(device):
        return None
    m, b0, delay = device.mass, device.friction, device.delay
    less, more = _span(lambda x: meets(replace(device, mass=m * math.exp(x))), math.inf)
    weaker, stronger = _span(lambda x: meets(replace(device, friction=b0 + b * x)), b0 / b)
    sooner, later = _span(lambda x: meets(replace(device, delay=delay + x)), delay)
    mass, friction = (m * math.exp(less), m * math.exp(more)), (b0 + b * weaker, b0 + b * stronger)
    return Tolerance(share, mass, friction, (delay + sooner, delay + later))


def _span(meets: Callable[[float], bool], most_less: float) -> tuple[float, float]:
    return _last(meets, -1, most_less), _last(meets, 1)


def _last(meets: Callable[[float], bool], side: int, most: float = math.inf) -> float:
    """How far from 0 to this side, and by `most` at most, what is asked is met without a gap; infinite for ever."""
    at, step = 0.0, _STEP
    while True:
        beyond = min(at + step, most)
        if at == most or at > _MOST * _LONGEST:
            return side * (at if at == most else math.inf)
        if not meets(side * beyond):
            break
        at, step = beyond, min(_LONGER * step, _LONGEST)
    for _ in range(_HALVINGS):
        middle = 0.5 * (at + beyond)
        at, beyond = (middle, beyond) if meets(side * middle) else (at, middle)
    return side * at
