"""The holds, samplings and dampers there are, by the names that a scene file uses; and how a delay is split."""

from __future__ import annotations

import math
from collections.abc import Callable

from hapsim.theory.interface.damper_backward import backward
from hapsim.theory.interface.damper_centred import centred
from hapsim.theory.interface.damper_filtered import filtered
from hapsim.theory.interface.damper_sensed import sensed
from hapsim.theory.interface.hold_impulse import IMPULSE
from hapsim.theory.interface.hold_zoh import ZERO_ORDER_HOLD
from hapsim.theory.interface.sampling_average import AVERAGE
from hapsim.theory.interface.sampling_ideal import IDEAL
from hapsim.theory.interface.shape import Damper, Hold, Sampling

HOLDS: dict[str, Hold] = {"zoh": ZERO_ORDER_HOLD, "impulse": IMPULSE}
SAMPLINGS: dict[str, Sampling] = {"ideal": IDEAL, "average": AVERAGE}

#: Each made from 2 pi times the cutoff frequency times the sample period, which only a filter looks at.
DAMPERS: dict[str, Callable[[float], Damper]] = {
    "backward": backward,
    "centred": centred,
    "filtered": filtered,
    "sensed": sensed,
}
WITH_CUTOFF = ("filtered",)


def damper_named(name: str, cutoff: float | None, rate: float) -> Damper:
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


def whole_and_fraction(delay: float) -> tuple[int, float]:
    """A delay in sample periods as whole samples and the fraction of one, 0 <= fraction < 1."""
    whole = math.floor(delay)
    return whole, delay - whole
