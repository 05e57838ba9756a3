"""What every peer can be asked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from schemes.strings import StringOfMasses


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


def held_mass(string: StringOfMasses) -> int:
    """The mass, from 0, that a hand holds: a third of the way."""
    return string.masses // 3


def hand_link(string: StringOfMasses) -> tuple[float, float]:
    """K in N/m and B in N·s/m between a hand and the mass it holds: a hundredth of a link's, so that a string that is
    stable stays so."""
    return 0.01 * string.stiffness, 0.01 * string.damping


def hand_motion(samples: int, rate: float) -> NDArray[np.float64]:
    """A hand that moves by 1 mm, twice a second; m, shape (samples,)."""
    return np.asarray(1e-3 * np.sin(4.0 * np.pi * np.arange(samples) / rate))
