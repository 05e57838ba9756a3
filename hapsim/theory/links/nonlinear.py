"""The link with curves: for a small swing its slope where it stands; for a large one, whatever lies in its sector.

A swing that is small against the pieces of the curve meets the slope of the piece that it is on. About a corner it
meets one slope on the way out and the other on the way in: for the motion's first harmonic, their mean (the describing
function of a corner, which is the same for every amplitude until the next corner).

A larger swing meets a weighted mean of slopes, between the least and the steepest of the curve: its sector. That the
loop is stable with every slope of the sector does not make it stable with the curve (Aizerman's conjecture is false).
What bounds it is passivity, with the steepest slope in place of the stiffness or damping and none below 0 (Colgate and
Schenkel; for curves, Miller, Colgate and Freeman 2000).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

from hapsim.theory.links.linear import Linear

Points = Sequence[tuple[float, float]]
"""Of a curve, by ascending abscissa: m or m/s, and N."""


class Sector(NamedTuple):
    """Between which slopes all of a curve lies, N/m or N·s/m."""

    least: float
    steepest: float


def sector(points: Points | None) -> Sector:
    """The least and the steepest slope of a curve, the level ends included; both are 0 where there is no curve."""
    slopes = [0.0, *_slopes(points or ())]
    return Sector(min(slopes), max(slopes))


def slope_at(points: Points | None, x: float) -> float:
    """The slope of a curve at `x`, at a corner the mean of the two beside it; 0 where there is no curve."""
    if not points:
        return 0.0
    slopes = [0.0, *_slopes(points), 0.0]
    before = sum(at < x for at, _ in points)
    not_after = sum(at <= x for at, _ in points)
    return 0.5 * (slopes[before] + slopes[not_after])


def nonlinear(over_distance: Points | None, over_velocity: Points | None) -> Linear:
    """The link for small motions about the place where its ends meet, and stand."""
    words = [
        f"between {least:g} and {steepest:g} {unit}"
        for (least, steepest), unit in ((sector(over_distance), "N/m"), (sector(over_velocity), "N·s/m"))
        if (least, steepest) != (0.0, 0.0)
    ]
    reach = f"; elsewhere they lie {' and '.join(words)}" if words else ""
    return Linear(
        slope_at(over_distance, 0.0),
        slope_at(over_velocity, 0.0),
        f"is taken with its slopes where its ends meet and stand{reach}",
        memoryless=True,
    )


def _slopes(points: Points) -> list[float]:
    return [(up - f) / (right - x) for (x, f), (right, up) in pairwise(points)]
