"""The holds: how a computed force becomes a force in time. A new one is an entry here, and its motion in the mock."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from hapsim.theory.interface.terms import Term


class HoldSegment(NamedTuple):
    """A part of one sample period, during which nothing changes but at its beginning.

    ``duration`` is in sample periods. ``kick`` and ``constant`` are the age, in whole samples beyond the
    delay's own, of the computed force that strikes as an impulse at the beginning, or acts throughout; None
    where there is none.
    """

    duration: float
    kick: int | None = None
    constant: int | None = None


class Hold(NamedTuple):
    """How a computed force becomes a force in time: its terms, and what it does in one sample period.

    ``lag`` is its mean delay in sample periods, what it costs a slow motion.

    ``segments`` is given the fraction of a sample period, 0 <= fraction < 1, by which a new force comes after
    a sample.
    """

    terms: tuple[Term, ...]
    lag: float
    segments: Callable[[float], list[HoldSegment]]


def _held(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction, constant=1), HoldSegment(1.0 - fraction, constant=0)]


def _struck(fraction: float) -> list[HoldSegment]:
    return [HoldSegment(fraction), HoldSegment(1.0 - fraction, kick=0)]


ZERO_ORDER_HOLD = Hold(terms=(Term(1.0, 0, 1), Term(-1.0, 1, 1)), lag=0.5, segments=_held)
"""Each computed force acts, constant, until the next one (Florens et al., §6.2)."""

IMPULSE = Hold(terms=(Term(1.0, 0, 0),), lag=0.0, segments=_struck)
"""Each computed force f strikes once, with the impulse f T (Florens et al., §6.1-6.3)."""

HOLDS: dict[str, Hold] = {"zoh": ZERO_ORDER_HOLD, "impulse": IMPULSE}
