"""The object that every scheme simulates: a string of equal masses and visco-elastic links, fixed at both ends."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class StringOfMasses:
    """N masses in one dimension (transverse), N + 1 equal links between them and the two fixed ends.

    m x_i'' = K (x_{i-1} - 2 x_i + x_{i+1}) + B (v_{i-1} - 2 v_i + v_{i+1}), in continuous time.

    `masses`: N. `mass`: of each, in kg. `stiffness`, `damping`: of each link, K in N/m and B in N·s/m.
    """

    masses: int
    mass: float
    stiffness: float
    damping: float

    @classmethod
    def tuned(
        cls, masses: int, total_mass: float = 0.005, fundamental: float = 20.0, damping_ratio: float = 1e-4
    ) -> StringOfMasses:
        """A string of `total_mass` in kg whose first mode rings at `fundamental` Hz with `damping_ratio`."""
        mass = total_mass / masses
        omega = 2.0 * math.pi * fundamental
        stiffness = mass * (omega / (2.0 * math.sin(math.pi / (2.0 * (masses + 1))))) ** 2
        return cls(masses, mass, stiffness, 2.0 * damping_ratio * stiffness / omega)

    def frequency(self, mode: int) -> float:
        """The undamped frequency in Hz of mode 1 to N. Damping proportional to stiffness leaves |s| of a mode there."""
        half_angle = math.pi * mode / (2.0 * (self.masses + 1))
        return 2.0 * math.sqrt(self.stiffness / self.mass) * math.sin(half_angle) / (2.0 * math.pi)

    def shape(self, mode: int) -> NDArray[np.float64]:
        """The masses' displacements in mode 1 to N, 1 at the most, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(np.sin(math.pi * mode * along))

    def plucked(self) -> NDArray[np.float64]:
        """The masses' displacements in m when the string is lifted by 1 mm at a third of its length, shape (N,)."""
        along = np.arange(1, self.masses + 1) / (self.masses + 1)
        return np.asarray(1e-3 * np.minimum(3.0 * along, 1.5 * (1.0 - along)))
