"""What each link is for small motions: a spring and a damper, under an assumption that is stated.

**Contact, plectrum.** Each is two linear systems, engaged and apart, and the change between them. That both are stable
does not make the whole stable. Passivity in touch bounds the contact (Colgate and Schenkel): then no change adds more
energy than one sample of approach does. The plectrum's release loses the energy of the spring, K release²/2. It grips
again where its ends have passed each other by at most v T, which adds up to K (v T)²/2.

**Curves.** A small swing meets the slope of its piece, about a corner the mean of the two slopes (the describing
function of a corner). A larger swing meets a weighted mean of slopes within the curve's sector. A loop that is stable
with every slope of the sector may be unstable with the curve (Aizerman's conjecture is false). Passivity bounds it,
with the steepest slope in place of the stiffness or damping and none below 0 (Colgate and Schenkel; for curves, Miller,
Colgate and Freeman 2000).

**Dry friction.** Stuck it is a spring, sliding a constant force. The larger the swing, the softer it is, and it always
brakes (Dahl; Hayward and Armstrong) - in continuous time. Sampled and delayed, the stuck bristle is a spring like any
other: where it is too stiff for the loop, the motion grows into a limit cycle about as wide as the bristle's reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

Points = Sequence[tuple[float, float]]
"""Of a curve, by ascending abscissa: m or m/s, and N."""


class Linear(NamedTuple):
    """What stands for a link in the linear theory.

    Attributes:
        stiffness: N/m.
        damping: N·s/m.
        assumption: under which this holds, in words that follow the link's name; "" where it always holds.
        memoryless: the force depends on the positions and velocities of the ends and on nothing earlier, apart from
            what the link's damper remembers.
        in_a_matrix: the link is exactly this spring and damper, so that a scheme can work it into a matrix.

    The last two are as the kernel's `PartType` says.
    """

    stiffness: float
    damping: float
    assumption: str = ""
    memoryless: bool = False
    in_a_matrix: bool = False


def viscoelastic(stiffness: float, damping: float) -> Linear:
    """A spring and a damper, N/m and N·s/m."""
    return Linear(stiffness, damping, memoryless=True, in_a_matrix=True)


def buffer(stiffness: float, damping: float) -> Linear:
    """The contact while it is touched, N/m and N·s/m."""
    return Linear(stiffness, damping, "is taken as touched all the time; apart, nothing is felt of it", memoryless=True)


def plectrum(stiffness: float, damping: float) -> Linear:
    """The plectrum while it grips, N/m and N·s/m."""
    return Linear(stiffness, damping, "is taken as gripping all the time; released, nothing is felt of it")


def friction(stiffness: float, damping: float) -> Linear:
    """Dry friction while it sticks, N/m and N·s/m: its bristle."""
    return Linear(stiffness, damping, "is taken as stuck, a spring; sliding, its force is constant and adds none")


class Sector(NamedTuple):
    """The slopes between which a whole curve lies, N/m or N·s/m."""

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
    """The link with curves, for small motions about the place where its ends meet and stand."""
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
