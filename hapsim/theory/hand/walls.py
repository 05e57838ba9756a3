"""The stiffest wall that a device renders: of all (K, B), the passive and the stable one with most stiffness.

Between the device alone and that wall lies what a device can render, its Z-width (Colgate and Brown, "Factors affecting
the Z-width of a haptic display", 1994).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.hand.configuration import Configuration

_POINTS, _ZOOMS = 61, 8


class StiffestWall(NamedTuple):
    """K in N/m and B in N·s/m; (0, 0) where no wall with a spring qualifies."""

    stiffness: float
    damping: float


def stiffest_passive(configuration: Configuration) -> StiffestWall:
    """That no hand whatever makes unstable (Colgate and Schenkel, 1997), B >= 0.

    The friction that passivity needs grows in proportion to the wall: along each direction of the (K, B) plane one wall
    needs just what the device has.

    Raises:
        ValueError: the passivity condition is not derived (``Configuration.needed_friction``).
    """
    unit = 2.0 * configuration.rate

    def stiffness(angle: Floats) -> Floats:
        K = unit * np.cos(angle)
        needed = np.asarray(configuration.needed_friction(K, np.sin(angle)))
        return np.asarray(K * (configuration.friction / needed))

    angle, K = _highest(stiffness, 0.0, 0.5 * np.pi * (1.0 - 1e-9))
    return StiffestWall(K, K * float(np.tan(angle)) / unit) if K > 0.0 else StiffestWall(0.0, 0.0)


def stiffest_stable(configuration: Configuration) -> StiffestWall:
    """That is stable with the hand's own mass, B >= 0."""

    def stiffness(B: Floats) -> Floats:
        most = np.asarray(configuration.stable_stiffness(B)[1])
        return np.where(np.isfinite(most), most, 0.0)

    B, K = _highest(stiffness, 0.0, 4.0 * configuration.damping_unit)
    return StiffestWall(K, B) if K > 0.0 else StiffestWall(0.0, 0.0)


def _highest(function: Callable[[Floats], Floats], low: float, high: float) -> tuple[float, float]:
    """(where, how much): the best point of a grid, then of finer ones about it."""
    best, most = low, 0.0
    for _ in range(_ZOOMS):
        at = np.linspace(low, high, _POINTS)
        value = function(at)
        place = int(np.argmax(value))
        if value[place] >= most:
            best, most = float(at[place]), float(value[place])
        step = at[1] - at[0]
        low, high = max(low, best - step), min(high, best + step)
    return best, most
