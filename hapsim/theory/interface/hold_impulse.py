"""The impulse hold: each computed force f strikes once, with the impulse f T (Florens et al., §6.1-6.3)."""

from __future__ import annotations

from hapsim.theory.interface.shape import Hold, Segment, Term


def _segments(fraction: float) -> list[Segment]:
    return [Segment(fraction), Segment(1.0 - fraction, kick=0)]


IMPULSE = Hold(terms=(Term(1.0, 0, 0),), lag=0.0, segments=_segments)
