"""The holds as the theory sees them: all of it follows from their transfer functions (`hapsim/holds.py`)."""

from __future__ import annotations

import itertools
import math

from hapsim.holds import HOLDS, Piece, Term

ROUNDING = 1e-12  # sample periods


def hold_lag(hold: str) -> float:
    """The mean delay of a hold in sample periods: how much later a slow motion meets its force."""
    return -math.fsum(
        weight * (-lag) ** (integrations + 1) / math.factorial(integrations + 1)
        for weight, lag, integrations in HOLDS[hold].terms
    )


def hold_segments(hold: str, fraction: float) -> list[Piece]:
    """One sample period of a hold in time, worked out from its transfer function.

    A new force acts from ``fraction`` of the period on, 0 <= fraction < 1. The durations add up to 1.
    """
    terms = HOLDS[hold].terms
    ends = [0.0, 1.0]
    for change in (fraction, *((fraction + term.lag) % 1.0 for term in terms)):
        if min(abs(change - end) for end in ends) > ROUNDING:
            ends.append(change)
    ends.sort()
    ages = range(math.floor(fraction + max(term.lag for term in terms)) + 1)
    return [
        Piece(end - begin, *(_weights(terms, order, begin, [fraction - age for age in ages]) for order in range(3)))
        for begin, end in itertools.pairwise(ends)
    ]


def _weights(terms: tuple[Term, ...], order: int, time: float, starts: list[float]) -> tuple[float, ...]:
    """What forces that act from ``starts`` on, by age, contribute at ``time``; nothing is written of those that are
    over."""
    weights = [_weight(terms, order, time, start) for start in starts]
    while weights and abs(weights[-1]) < ROUNDING:
        weights.pop()
    return tuple(weights)


def _weight(terms: tuple[Term, ...], order: int, time: float, start: float) -> float:
    """What one force that acts from ``start`` on contributes at ``time``: its impulse, level or slope, by ``order``."""
    weight = 0.0
    for term in terms:
        since = time - (start + term.lag)
        if order == 0 and term.integrations == 0:
            weight += term.weight if abs(since) < ROUNDING else 0.0
        elif 0 < order <= term.integrations and since > -ROUNDING:
            power = term.integrations - order
            weight += term.weight * max(since, 0.0) ** power / math.factorial(power)
    return weight
