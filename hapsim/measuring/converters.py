"""How a device holds a force and samples its position: all that measuring knows of a hold, by its pieces in time."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.holds import HOLDS

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Piece(NamedTuple):
    """What a force of some age does in one piece of a hold: an impulse at its begin, then a level and a slope."""

    begin: float
    """Sample periods after the force began to act."""
    duration: float
    impulse: float
    level: float
    slope: float


class Converters(NamedTuple):
    """The device's hold and sampling, by the scene's names."""

    hold: str
    sampling: str

    @property
    def keeps_last_force(self) -> bool:
        """Whether a force that is not renewed in time goes on, or else ends."""
        return HOLDS[self.hold].keeps_last_force

    @property
    def averages(self) -> bool:
        """Whether a position is the mean over the sample period before it."""
        return self.sampling == "average"

    def pieces_of_one_force(self) -> Iterator[Piece]:
        """All that one force does, from when it begins to act."""
        begin = 0.0
        for duration, *weights in HOLDS[self.hold].pieces(0.0):
            for age, (impulse, level, slope) in enumerate(itertools.zip_longest(*weights, fillvalue=0.0)):
                yield Piece(begin + age, duration, impulse, level, slope)
            begin += duration

    def response(self, frequency: Floats, rate: float, delay: float) -> Complexes:
        """(n,) by what a computed force becomes one that acts, and a motion one that is read: hold, `delay` samples and
        sampling together, at frequencies in Hz."""
        angle = 2.0 * np.pi * frequency / rate
        nodes, weights = np.polynomial.legendre.leggauss(16)  # to rounding, up to half the sample rate
        held = np.zeros(angle.size, complex)
        for begin, duration, impulse, level, slope in self.pieces_of_one_force():
            times, shares = 0.5 * duration * (nodes + 1.0), 0.5 * duration * weights
            turned = np.exp(-1j * np.multiply.outer(angle, begin + times)) @ (shares * (level + slope * times))
            held += impulse * np.exp(-1j * angle * begin) + turned
        mean = np.exp(-0.5j * angle) * np.sinc(0.5 * angle / np.pi) if self.averages else 1.0
        return np.asarray(held * mean * np.exp(-1j * delay * angle))
