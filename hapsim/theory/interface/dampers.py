"""The dampers: how readings become the velocity that a link's damping acts on. A new one is a function and a line here,
and its recurrence in the kernel (`hapsim/cordis/modules`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes


class DamperModel(NamedTuple):
    """How readings become the velocity that a link's damping acts on, in metres per sample period.

    v[n] is the sum of ``of_positions`` over y[n], y[n-1], ... and of ``of_velocities`` over v[n-1], v[n-2], ...
    Where it ``senses``, the device sends the velocity of its own end, and they stand for the other end alone.
    """

    of_positions: tuple[float, ...]
    of_velocities: tuple[float, ...] = ()
    senses: bool = False


def backward(_cutoff: float) -> DamperModel:
    """v[n] = (y[n] - y[n-1])/T (first-order Euler; Florens et al., §6); v/y = w/(w + 1)."""
    return DamperModel(of_positions=(1.0, -1.0))


def centred(_cutoff: float) -> DamperModel:
    """v[n] = (y[n] - y[n-2])/(2 T), the velocity at the sample before; v/y = w (1 + w/2)/(1 + w)²."""
    return DamperModel(of_positions=(0.5, 0.0, -0.5))


def filtered(cutoff: float) -> DamperModel:
    """v[n] = (1 - a) v[n-1] + a (y[n] - y[n-1])/T, a = 1 - exp(-cutoff); v/y = w a/(w + a).

    A low-pass of first order behind the backward difference, with the poles of its continuous model
    1/(1 + s/(2 pi cutoff)). ``cutoff``: 2 pi times the cutoff frequency times the sample period.
    """
    a = -math.expm1(-cutoff)
    return DamperModel(of_positions=(a, -a), of_velocities=(math.exp(-cutoff),))


def sensed(_cutoff: float) -> DamperModel:
    """v[n] is what the device itself measures, late and held like the position: a second output of the plant.

    With averaged sampling it is the mean velocity over the sample period that has just ended. A simulated end has no
    sensor: its velocity is the backward difference of its positions.
    """
    return DamperModel(of_positions=(1.0, -1.0), senses=True)


#: Each made from 2 pi times the cutoff frequency times the sample period, which only a filter uses.
DAMPERS: dict[str, Callable[[float], DamperModel]] = {
    "backward": backward,
    "centred": centred,
    "filtered": filtered,
    "sensed": sensed,
}
WITH_CUTOFF = ("filtered",)


def damper_named(name: str, cutoff: float | None, rate: float) -> DamperModel:
    """The damper of this name. ``cutoff`` and ``rate``: Hz; a filter needs its cutoff, and nothing else has one.

    Raises:
        ValueError: the name is unknown, or the cutoff is missing, superfluous or not above zero.
    """
    if name not in DAMPERS:
        raise ValueError(f"damper is {name!r}, but it has to be one of: {', '.join(DAMPERS)}.")
    if name not in WITH_CUTOFF:
        if cutoff is not None:
            raise ValueError(f"cutoff is {cutoff!r}, but the {name} damper has none: leave it out.")
        return DAMPERS[name](math.inf)
    if cutoff is None or not 0.0 < cutoff < math.inf:
        raise ValueError(f"cutoff is {cutoff!r}, but the {name} damper needs one, in Hz, greater than zero.")
    return DAMPERS[name](2.0 * math.pi * cutoff / rate)


def damper_answer(damper: DamperModel, z: Complexes, w: Complexes) -> Complexes:
    """v/y of the damper's recurrence; its weights of positions add up to zero, which leaves a factor 1 - 1/z = w/z."""
    from_positions = np.polyval(np.cumsum(damper.of_positions)[-2::-1], 1.0 / z)
    return w / z * from_positions / (1.0 - np.polyval([*damper.of_velocities[::-1], 0.0], 1.0 / z))
