"""How heavy masses feel that a hand shakes.

A hand of stiffness kh, a spring beside the device, shakes what it holds. Of the slowest swing s a rigid mass
M' = kh/|s|² - m would have the same, m the device's own. In continuous time the same rule says what of it is the
coupling's: a mass behind a spring feels heavier the faster it is shaken.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from hapsim.theory.arrays import Complexes
from hapsim.theory.network.continuous import matrices
from hapsim.theory.network.modes import poles_of
from hapsim.theory.network.network import Network

_MEMORY = 1e-7  # a pole of smaller modulus is a memory that empties
_SWINGS = 1e-9  # of itself: what turns by less creeps


def felt_mass(network: Network, hand_stiffness: float) -> tuple[float, float]:
    """kg, of the masses in the loop, and Hz: how fast a hand of so many N/m shakes them; NaN where nothing swings.

    ``network``: one channel and what it moves, which is not large.
    """
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    poles = poles_of(held)
    s = network.rate * np.log(poles[np.abs(poles) > _MEMORY].astype(complex))
    return _of_slowest(held, s)


def continuous_mass(network: Network, hand_stiffness: float) -> float:
    """kg, that the same masses have in continuous time."""
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    M, Z, K = matrices(held)
    size, mass = len(M), np.diag(M)[:, None]
    change = np.block([[np.zeros((size, size)), np.eye(size)], [-K / mass, -Z / mass]])
    return _of_slowest(held, np.linalg.eigvals(change).astype(complex))[0]


def _of_slowest(network: Network, s: Complexes) -> tuple[float, float]:
    swinging = s[s.imag > _SWINGS * np.abs(s)]
    if not swinging.size:
        return math.nan, math.nan
    slowest = swinging[np.argmin(np.abs(swinging))]
    mass = float(network.channel_stiffness[0] / np.abs(slowest) ** 2 - network.channel_mass[0])
    return mass, float(slowest.imag) / (2.0 * math.pi)
