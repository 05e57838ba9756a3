"""The string that is rung: equal masses and visco-elastic links, fixed at both ends, and where it rings in truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StringOfMasses:
    """N masses in one dimension (transverse), N + 1 equal links between them and the two fixed ends.

    m x_i'' = K (x_{i-1} - 2 x_i + x_{i+1}) + B (v_{i-1} - 2 v_i + v_{i+1}), in continuous time; with bending, and u_i
    for x_{i-1} - 2 x_i + x_{i+1} (0 at the ends), S (u_{i-1} - 2 u_i + u_{i+1}) is subtracted.

    `masses`: N. `mass`: of each, in kg. `stiffness`, `damping`: of each link, K in N/m and B in N·s/m. `bending`: S in
    N/m.
    """

    masses: int
    mass: float
    stiffness: float
    damping: float
    bending: float = 0.0

    @classmethod
    def tuned(
        cls,
        masses: int,
        total_mass: float = 0.005,
        fundamental: float = 20.0,
        damping_ratio: float = 1e-4,
        sharp: float = 0.0,
    ) -> StringOfMasses:
        """A string of `total_mass` in kg whose first mode rings at `fundamental` Hz with `damping_ratio`, but for the
        bending, which makes mode 5 so much higher: `sharp`, relative."""
        mass = total_mass / masses
        omega = 2.0 * math.pi * fundamental
        stiffness = mass * (omega / (2.0 * math.sin(math.pi / (2.0 * (masses + 1))))) ** 2
        of_mode_5 = (2.0 * math.sin(5.0 * math.pi / (2.0 * (masses + 1)))) ** 2
        bending = stiffness * ((1.0 + sharp) ** 2 - 1.0) / of_mode_5
        return cls(masses, mass, stiffness, 2.0 * damping_ratio * stiffness / omega, bending)

    def frequency(self, mode: int) -> float:
        """The undamped frequency in Hz of mode 1 to N: |s| of its poles over 2 pi, which no damping moves."""
        square = 4.0 * math.sin(math.pi * mode / (2.0 * (self.masses + 1))) ** 2
        return math.sqrt((self.stiffness + self.bending * square) * square / self.mass) / (2.0 * math.pi)

    def shape(self, mode: int) -> NDArray[np.float64]:
        """The masses' displacements in mode 1 to N, 1 at the most, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(np.sin(math.pi * mode * along))

    def plucked(self) -> NDArray[np.float64]:
        """The masses' displacements in m when the string is lifted by 1 mm at a third of its length, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(1e-3 * np.minimum(3.0 * along, 1.5 * (1.0 - along)))


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
