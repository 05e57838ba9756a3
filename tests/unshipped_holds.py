"""Holds that hapsim does not ship: all that an entry of HOLDS can say, by transfer function and by pieces in time."""

from __future__ import annotations

from hapsim.holds import Hold, Piece, Term


def straight(fraction: float) -> list[Piece]:
    """On from the newest force, by as much as that differs from the one before (first-order hold)."""
    late = Piece(fraction, level=(0.0, 2.0 - fraction, fraction - 1.0), slope=(0.0, 1.0, -1.0))
    return [late, Piece(1.0 - fraction, level=(1.0,), slope=(1.0, -1.0))]


def mean_of_two(fraction: float) -> list[Piece]:
    return [Piece(fraction, level=(0.0, 0.5, 0.5)), Piece(1.0 - fraction, level=(0.5, 0.5))]


def half_as_long(fraction: float) -> list[Piece]:
    """Twice the force for half a period."""
    if fraction < 0.5:
        return [Piece(fraction), Piece(0.5, level=(2.0,)), Piece(0.5 - fraction)]
    return [Piece(fraction - 0.5, level=(0.0, 2.0)), Piece(0.5), Piece(1.0 - fraction, level=(2.0,))]


def two_blows(fraction: float) -> list[Piece]:
    """A quarter of the impulse at once, the others half a period later."""
    if fraction < 0.5:
        return [Piece(fraction), Piece(0.5, impulse=(0.25,)), Piece(0.5 - fraction, impulse=(0.75,))]
    return [Piece(fraction - 0.5), Piece(0.5, impulse=(0.0, 0.75)), Piece(1.0 - fraction, impulse=(0.25,))]


def blow_and_level(fraction: float) -> list[Piece]:
    return [Piece(fraction, level=(0.0, 0.6)), Piece(1.0 - fraction, impulse=(0.4,), level=(0.6,))]


def sawtooth(fraction: float) -> list[Piece]:
    """Half as much again, that goes down to half."""
    late = Piece(fraction, level=(0.0, 0.5 + fraction), slope=(0.0, -1.0))
    return [late, Piece(1.0 - fraction, level=(1.5,), slope=(-1.0,))]


_FIRST_ORDER = tuple(Term(weight, lag, i) for i in (1, 2) for lag, weight in enumerate((1.0, -2.0, 1.0)))
_SAWTOOTH = (Term(1.5, 0.0, 1), Term(-1.0, 0.0, 2), Term(-0.5, 1.0, 1), Term(1.0, 1.0, 2))
_HALF, _BLOWS = (Term(2.0, 0.0, 1), Term(-2.0, 0.5, 1)), (Term(0.25, 0.0, 0), Term(0.75, 0.5, 0))

UNSHIPPED = {
    "straight": Hold("straight", "", _FIRST_ORDER, straight),
    "mean of two": Hold("mean of two", "", (Term(0.5, 0.0, 1), Term(-0.5, 2.0, 1)), mean_of_two),
    "half as long": Hold("half as long", "", _HALF, half_as_long, keeps_last_force=False),
    "two blows": Hold("two blows", "", _BLOWS, two_blows, keeps_last_force=False),
    "blow and level": Hold(
        "blow and level", "", (Term(0.4, 0.0, 0), Term(0.6, 0.0, 1), Term(-0.6, 1.0, 1)), blow_and_level
    ),
    "sawtooth": Hold("sawtooth", "", _SAWTOOTH, sawtooth),
}
LAGS = {"straight": 0.0, "mean of two": 1.0, "half as long": 0.25, "two blows": 0.375, "blow and level": 0.3}
LAGS |= {"sawtooth": 5 / 12}
