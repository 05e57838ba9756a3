"""The holds: the force of a device between two received forces.

Each hold is declared here once and described twice, independently. Its transfer function is for whatever predicts:
`hapsim.theory` derives all that it needs from it. Its pieces in time are for whatever moves or measures: the mock, the
guards that need the force that acted, and the identification. A wrong hold therefore cannot confirm itself: a test
compares the two, and every measurement compares them again with its prediction.

Nothing else branches on a hold's name. To add one, add an entry to HOLDS.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Term(NamedTuple):
    """One term ``weight · exp(-lag s) / s^integrations`` of a transfer function, time in sample periods."""

    weight: float
    lag: float
    integrations: int


class Piece(NamedTuple):
    """A part of one sample period in which the force is continuous.

    The weights are those of the received forces: the first is the weight of the newest force whose delay ends within
    the period, the next the weight of the force before, and so on. Omitted weights are 0.
    """

    duration: float
    """sample periods"""
    impulse: tuple[float, ...] = ()
    """of the impulse at the beginning of the piece, in sample periods"""
    level: tuple[float, ...] = ()
    """of the force at the beginning of the piece"""
    slope: tuple[float, ...] = ()
    """of what the force grows by in a sample period"""


class Hold(NamedTuple):
    """Reconstruction of a continuous force from received forces.

    The mean of the force is the mean of the received forces, so that a slow motion meets the simulated stiffness.
    """

    label: str
    """as tables and pictures name it"""
    meaning: str
    """what the device does, for help texts and the scene's schema"""
    terms: tuple[Term, ...]
    """the transfer function from the received forces, as impulses, to the force in time"""
    pieces: Callable[[float], list[Piece]]
    """one sample period in time, for the fraction of a sample period, 0 <= fraction < 1, by which a new force acts
    after a sample; the durations add up to 1"""
    keeps_last_force: bool = True
    """whether the last force goes on where no new one arrives"""

    @property
    def has_impulses(self) -> bool:
        """True if the force is not finite at some instants."""
        return any(term.integrations == 0 for term in self.terms)

    @property
    def mean_delay(self) -> float:
        """The mean delay in sample periods, from the pieces: the first moment of what one force does."""
        moment, begin = 0.0, 0.0
        for duration, impulse, level, slope in self.pieces(0.0):
            for age, weight in enumerate(impulse):
                moment += weight * (age + begin)
            for age, weight in enumerate(level):
                moment += weight * duration * (age + begin + duration / 2.0)
            for age, weight in enumerate(slope):
                moment += weight * duration**2 * ((age + begin) / 2.0 + duration / 3.0)
            begin += duration
        return moment


def _zero_order(fraction: float) -> list[Piece]:
    return [Piece(fraction, level=(0.0, 1.0)), Piece(1.0 - fraction, level=(1.0,))]


def _impulses(fraction: float) -> list[Piece]:
    return [Piece(fraction), Piece(1.0 - fraction, impulse=(1.0,))]


def _ramps(fraction: float) -> list[Piece]:
    before = Piece(fraction, level=(0.0, 1.0 - fraction, fraction), slope=(0.0, 1.0, -1.0))
    return [before, Piece(1.0 - fraction, level=(0.0, 1.0), slope=(1.0, -1.0))]


HOLDS: dict[str, Hold] = {
    "zoh": Hold(
        label="zero-order hold",
        meaning="each force acts, constant, until the next one",  # Florens et al., §6.2
        terms=(Term(1.0, 0.0, 1), Term(-1.0, 1.0, 1)),
        pieces=_zero_order,
    ),
    "impulse": Hold(
        label="impulse hold",
        meaning="each force f is applied at once, as the impulse f T",  # Florens et al., §6.1-6.3
        terms=(Term(1.0, 0.0, 0),),
        pieces=_impulses,
        keeps_last_force=False,
    ),
    "ramp": Hold(
        label="ramp hold",
        meaning="the force moves from the last one to the new one within one sample period",  # linear interpolation
        terms=(Term(1.0, 0.0, 2), Term(-2.0, 1.0, 2), Term(1.0, 2.0, 2)),
        pieces=_ramps,
    ),
}
"""The holds by the names that a scene uses. The first is the default."""
