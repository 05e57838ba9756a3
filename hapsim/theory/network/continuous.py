"""The same scene in continuous time: what sampling, hold and delay deform.

M x'' + Z x' + K x = 0, the device's own friction and springs in Z and K; every link a spring and a damper, whatever
its damper takes for a velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network.network import Network


class ContinuousMode(NamedTuple):
    """One motion of the continuous scene by itself: a conjugate pair, or a real root.

    Attributes:
        root: s in 1/s; of a pair, the one above the real axis.
        participation: (C + M,) each point's share of the kinetic energy, sum 1, device channels first.
    """

    root: complex
    participation: Floats

    @property
    def frequency_hz(self) -> float:
        """|s|/(2 pi), the undamped eigenfrequency."""
        return abs(self.root) / (2.0 * math.pi)

    @property
    def damping_ratio(self) -> float:
        """-Re s/|s|; NaN where it rests."""
        return -self.root.real / abs(self.root) if self.root else math.nan


def matrices(network: Network) -> tuple[Floats, Floats, Floats]:
    """(M, Z, K), each (C + M, C + M): kg, N·s/m, N/m."""
    mass = np.concatenate([network.channel_mass, network.point_mass])
    M = np.diag(mass)
    own = np.zeros(network.point_mass.size)
    Z = np.diag(np.concatenate([network.channel_friction, own]))
    K = np.diag(np.concatenate([network.channel_stiffness, own]))
    for (a, b), stiffness, damping in zip(network.ends, network.stiffness, network.damping, strict=True):
        for matrix, value in ((K, stiffness), (Z, damping)):
            for one, other in ((a, b), (b, a)):
                if one >= 0:
                    matrix[one, one] += value
                    if other >= 0:
                        matrix[one, other] -= value
    return M, Z, K


def continuous_modes(network: Network) -> list[ContinuousMode]:
    """Every mode, the slowest to decay first; those at rest too."""
    M, Z, K = matrices(network)
    size = len(M)
    if size == 0:
        return []
    inverse = 1.0 / np.diag(M)[:, None]
    step = np.block([[np.zeros((size, size)), np.eye(size)], [-inverse * K, -inverse * Z]])
    roots, vectors = np.linalg.eig(step)
    return _modes_of(roots.astype(complex), vectors[size:], np.diag(M))


def _modes_of(roots: Complexes, velocities: Complexes, mass: Floats) -> list[ContinuousMode]:
    modes = []
    for root, velocity in zip(roots, velocities.T, strict=True):
        if root.imag < 0.0:
            continue
        energy = mass * np.abs(velocity) ** 2
        total = energy.sum()
        share = energy / total if total > 0.0 else np.full(mass.size, 1.0 / mass.size)
        modes.append(ContinuousMode(complex(root), share))
    return sorted(modes, key=lambda mode: -mode.root.real)
