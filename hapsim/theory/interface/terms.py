"""In what holds and samplings are written as transfer functions.

Each hold, sampling and damper is described twice, and different codes read the two descriptions on purpose: its
transfer function the characteristic equation (``plant.py``, ``loop_equation.py``), its behaviour in time the state
space (``device_step.py``, ``state.py``). That the two agree is a test of both.
"""

from __future__ import annotations

import math
from typing import NamedTuple


class Term(NamedTuple):
    """One term ``weight · exp(-lag s) / s^integrations`` of a transfer function, time in sample periods."""

    weight: float
    lag: float
    integrations: int


def product(one: tuple[Term, ...], other: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms of two transfer functions in series."""
    return tuple(Term(a.weight * b.weight, a.lag + b.lag, a.integrations + b.integrations) for a in one for b in other)


def whole_and_fraction(delay: float) -> tuple[int, float]:
    """A delay in sample periods as whole samples and the fraction of one, 0 <= fraction < 1."""
    whole = math.floor(delay)
    return whole, delay - whole
