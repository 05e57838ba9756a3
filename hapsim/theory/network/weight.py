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
from hapsim.theory.network.continuous import first_order
from hapsim.theory.network.network import Network
from hapsim.theory.sample import loop

_MEMORY = 1e-7  # a pole of smaller modulus is a memory that empties
_ALONG = 0.3  # of the masses' way: by less the hand does not shake them
_SWINGS = 1e-9  # of itself: what turns by less creeps


def felt_mass(network: Network, hand_stiffness: float) -> tuple[float, float]:
    """kg, of the masses in the loop, and Hz: how fast a hand of this stiffness (N/m) shakes them; NaN where nothing
    swings, and where the hand hardly moves in it: that swing is of the masses alone.

    ``network``: one channel and what it moves, which is not large.
    """
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    change, points, *_ = loop(held)
    w, states = np.linalg.eig(change)
    kept = np.abs(1.0 + w) > _MEMORY
    s = np.asarray(network.rate * np.log1p(w[kept].astype(complex)), complex)
    return _of_slowest(held, s, points @ states[:, kept])


def continuous_mass(network: Network, hand_stiffness: float) -> float:
    """kg, that the same masses have in continuous time."""
    held = replace(network, channel_stiffness=np.array([hand_stiffness]))
    roots, states = np.linalg.eig(first_order(held))
    return _of_slowest(held, np.asarray(roots, complex), states[: len(states) // 2])[0]


def _of_slowest(network: Network, s: Complexes, moved: Complexes) -> tuple[float, float]:
    swinging = np.flatnonzero(s.imag > _SWINGS * np.abs(s))
    if not swinging.size:
        return math.nan, math.nan
    slowest = swinging[np.argmin(np.abs(s[swinging]))]
    hand, *masses = np.abs(moved[:, slowest])
    together = math.sqrt(float(network.point_mass @ np.square(masses)) / network.point_mass.sum())
    mass = float(network.channel_stiffness[0] / np.abs(s[slowest]) ** 2 - network.channel_mass[0])
    if mass <= 0.0 or hand < _ALONG * together:
        return math.nan, math.nan
    return mass, float(s[slowest].imag) / (2.0 * math.pi)
