"""Interface of every peer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from hapsim.speed_accuracy.strings import StringOfMasses


class Peer(Protocol):
    """A simulator of strings.

    `precision`: of its numbers. `preparation_s`: how long it took to get something that runs, from the last string
    asked for, or None where that is not worth telling. `note`: what else there is to say of that string; where a peer
    gave up, why.
    """

    name: str
    precision: str
    preparation_s: float | None
    note: str

    def available(self) -> str:
        """ "" or why it cannot run here."""

    def cost(self, string: StringOfMasses, rate: float, rounds: int) -> list[float]:
        """Seconds of processor time for a simulated second at `rate` Hz, one for each round; [] where it gave up."""

    def frequencies(self, string: StringOfMasses, rate: float, modes: Sequence[int]) -> list[float]:
        """The eigenfrequency in Hz that each mode rings at; NaN where the string is unstable or the peer gave up."""
