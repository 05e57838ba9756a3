"""The zero-order hold: each computed force acts, constant, until the next one (Florens et al., §6.2)."""

from __future__ import annotations

from hapsim.theory.interface.shape import Hold, Segment, Term


def _segments(fraction: float) -> list[Segment]:
    return [Segment(fraction, constant=1), Segment(1.0 - fraction, constant=0)]


ZERO_ORDER_HOLD = Hold(terms=(Term(1.0, 0, 1), Term(-1.0, 1, 1)), lag=0.5, segments=_segments)
