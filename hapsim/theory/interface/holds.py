"""The holds: how a computed force becomes a force in time. A new one is an entry here, and its pieces in the mock
(`hapsim/device/mock/sampler.py`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hapsim.theory.interface.samplings import Term


class HoldSegment(NamedTuple):
    """A part of one sample period, at whose beginning alone the force jumps or strikes.

    The force is made of the computed forces by weights: the first is that of the newest one whose delay is over before
    the end of the period, the next that of the one before it, and so on; what is left out is 0.

    Attributes:
        duration: in sample periods.
        kick: weights of the impulse at the beginning, in sample periods.
        level: weights of the force at the beginning.
        slope: weights of what the force grows by in a sample period.
    """

    duration: float
    kick: tuple[float, ...] = ()
    level: tuple[float, ...] = ()
    slope: tuple[float, ...] = ()


class Hold(NamedTuple):
    """How a computed force becomes a force in time: its terms, and what it does in one sample period.

    ``segments`` is given the fraction of a sample period, 0 <= fraction < 1, by which a new force comes after
    a sample; their durations add up to 1. The mean of the force is that of the computed forces, so that a slow
    motion meets the stiffness that is simulated.
    """

    terms: tuple[Term, ...]
    segments: Callable[[float], list[HoldSegment]]

    @property
    def lag(self) -> float:
        """Its mean delay in sample periods, what it costs a slow motion: the first moment of what one force does."""
        lag, begin = 0.0, 0.0
        for duration, kick, level, slope in self.segments(0.0):
            for age, weight in enumerate(kick):
                lag += weight * (age + begin)
            for age, weight in enumerate(level):
                lag += weight * duration * (age + begin + duration / 2.0)
            for age, weight in enumerate(slope):
                lag += weight * duration**2 * ((age + begin) / 2.0 + duration / 3.0)
            begin += duration
        return lag


def _held(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction, level=(0.0, 1.0)), HoldSegment(1.0 - fraction, level=(1.0,))]


def _struck(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction), HoldSegment(1.0 - fraction, kick=(1.0,))]


ZERO_ORDER_HOLD = Hold(terms=(Term(1.0, 0.0, 1), Term(-1.0, 1.0, 1)), segments=_held)
"""Each computed force acts, constant, until the next one (Florens et al., §6.2)."""

IMPULSE = Hold(terms=(Term(1.0, 0.0, 0),), segments=_struck)
"""Each computed force f strikes once, with the impulse f T (Florens et al., §6.1-6.3)."""

HOLDS: dict[str, Hold] = {"zoh": ZERO_ORDER_HOLD, "impulse": IMPULSE}
