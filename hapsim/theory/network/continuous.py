"""The same scene in continuous time: what sampling, hold and delay deform.

M x'' + Z x' + K x = 0, the device's own friction and springs in Z and K; every link a spring and a damper, whatever
its damper takes for a velocity.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.network.network import Network
from hapsim.theory.rows import Rows, stretches_of, times, unit_rows


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


def matrices(network: Network, sparse: bool = False) -> tuple[Rows, Rows, Rows]:
    """(M, Z, K), each (C + M, C + M): kg, N·s/m, N/m."""
    mass, stretches = np.concatenate([network.channel_mass, network.point_mass]), stretches_of(network, sparse)
    one, others = unit_rows(mass.size, sparse), np.zeros(network.point_mass.size)
    Z, K = (
        stretches.T @ times(of_links, stretches) + times(np.concatenate([own, others]), one)
        for of_links, own in (
            (network.damping, network.channel_friction),
            (network.stiffness, network.channel_stiffness),
        )
    )
    return times(mass, one), Z, K


def first_order(network: Network) -> Floats:
    """(2 C + 2 M, 2 C + 2 M): what the rates of positions and velocities are of these, 1/s."""
    M, Z, K = matrices(network)
    size, mass = len(M), np.diag(M)[:, None]
    return np.block([[np.zeros((size, size)), np.eye(size)], [-K / mass, -Z / mass]])


def continuous_modes(network: Network) -> list[ContinuousMode]:
    """Every mode, the slowest to decay first; those at rest too."""
    mass = np.concatenate([network.channel_mass, network.point_mass])
    size = mass.size
    if size == 0:
        return []
    roots, vectors = np.linalg.eig(first_order(network))
    energy = mass[:, None] * np.abs(vectors[size:]) ** 2
    total = energy.sum(axis=0)
    share = np.where(total > 0.0, energy / np.where(total > 0.0, total, 1.0), 1.0 / size)
    modes = [ContinuousMode(complex(roots[i]), share[:, i]) for i in range(roots.size) if roots[i].imag >= 0.0]
    return sorted(modes, key=lambda mode: -mode.root.real)
