"""The device's hold and position sampling, and their frequency response."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.holds import HOLDS

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Converters(NamedTuple):
    """The device's hold and sampling, named as in the scene."""

    hold: str
    sampling: str

    @property
    def keeps_last_force(self) -> bool:
        """True if a force that is not renewed in time goes on; False if it ends."""
        return HOLDS[self.hold].keeps_last_force

    @property
    def averages(self) -> bool:
        """True if a position is the mean over the sample period before it."""
        return self.sampling == "average"

    def response(self, frequency: Floats, rate: float, delay: float) -> Complexes:
        """Returns the response (n,) of hold, `delay` samples and sampling together, at frequencies (n,) in Hz: from a
        computed force to the acting one, and from a motion to the sampled one."""
        angle = 2.0 * np.pi * frequency / rate
        nodes, shares = np.polynomial.legendre.leggauss(16)  # to rounding, up to half the sample rate
        held, begin = np.zeros(angle.size, complex), 0.0
        for duration, *weights in HOLDS[self.hold].pieces(0.0):
            times = 0.5 * duration * (nodes + 1.0)
            # A force of each age: an impulse as the piece begins, then a level and a slope.
            for age, (impulse, level, slope) in enumerate(itertools.zip_longest(*weights, fillvalue=0.0)):
                turned = np.exp(-1j * np.multiply.outer(angle, begin + age + times))
                held += impulse * np.exp(-1j * angle * (begin + age))
                held += turned @ (0.5 * duration * shares * (level + slope * times))
            begin += duration
        mean = np.exp(-0.5j * angle) * np.sinc(0.5 * angle / np.pi) if self.averages else 1.0
        return np.asarray(held * mean * np.exp(-1j * delay * angle))
