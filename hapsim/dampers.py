"""The dampers: computation of the velocity that a link's damping acts on.

Each damper is declared here once and described twice, independently. Its weights are for whatever predicts:
`hapsim.theory` derives its transfer function from them. Its recurrence in the kernel
(`hapsim/cordis/modules/linear_links.py`) is what runs. A wrong damper therefore cannot confirm itself: tests compare
the two.

To add one, add an entry to DAMPERS, and its recurrence in the kernel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple


class DamperModel(NamedTuple):
    """Computation of the velocity that a link's damping acts on, in metres per sample period.

    v[n] is the sum of ``of_positions`` over y[n], y[n-1], ... and of ``of_velocities`` over v[n-1], v[n-2], ...
    Where it ``senses``, the device sends the velocity of its own end, and they stand for the other end alone.
    """

    of_positions: tuple[float, ...]
    of_velocities: tuple[float, ...] = ()
    senses: bool = False


class Damper(NamedTuple):
    """A damper by its name in a scene."""

    meaning: str
    """where the velocity comes from, for help texts and the scene's schema"""
    model: Callable[[float], DamperModel]
    """made of 2 pi times the cutoff frequency times the sample period, which only a filter uses"""
    has_cutoff: bool = False

    @property
    def senses(self) -> bool:
        """True if it reads the device's own velocity sensor."""
        return self.model(math.inf).senses

    @property
    def looks_back(self) -> int:
        """Age of its oldest position, samples."""
        return len(self.model(math.inf).of_positions) - 1


def _backward(_cutoff: float) -> DamperModel:
    """v[n] = (y[n] - y[n-1])/T (first-order Euler; Florens et al., §6); v/y = w/(w + 1)."""
    return DamperModel(of_positions=(1.0, -1.0))


def _centred(_cutoff: float) -> DamperModel:
    """v[n] = (y[n] - y[n-2])/(2 T), the velocity at the sample before; v/y = w (1 + w/2)/(1 + w)²."""
    return DamperModel(of_positions=(0.5, 0.0, -0.5))


def _filtered(cutoff: float) -> DamperModel:
    """v[n] = (1 - a) v[n-1] + a (y[n] - y[n-1])/T, a = 1 - exp(-cutoff); v/y = w a/(w + a).

    A low-pass of first order behind the backward difference, with the poles of its continuous model
    1/(1 + s/(2 pi cutoff)).
    """
    a = -math.expm1(-cutoff)
    return DamperModel(of_positions=(a, -a), of_velocities=(math.exp(-cutoff),))


def _sensed(_cutoff: float) -> DamperModel:
    """v[n] is what the device itself measures, late and held like the position: a second output of the plant.

    With averaged sampling it is the mean velocity over the sample period that has just ended. A simulated end has no
    sensor: its velocity is the backward difference of its positions.
    """
    return DamperModel(of_positions=(1.0, -1.0), senses=True)


DAMPERS: dict[str, Damper] = {
    "backward": Damper("the last two positions", _backward),
    "centred": Damper("the last and the last but one before", _centred),
    "filtered": Damper("a low-pass behind the first", _filtered, has_cutoff=True),
    "sensed": Damper("the device's own sensor", _sensed),
}
"""The dampers by the names that a scene uses. The first is the default."""
