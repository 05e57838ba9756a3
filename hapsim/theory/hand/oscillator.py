"""The real oscillator that everything is compared with: m x'' + b x' + k x = 0."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Floats


def frequency_and_ratio(mass: ArrayLike, k: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    """Eigenfrequency and damping ratio of a real mass, spring and damper (Florens et al., §5).

    Args:
        mass: kg, > 0.
        k: stiffness, N/m. Arrays broadcast.
        b: damping, N·s/m.

    Returns:
        The undamped eigenfrequency sqrt(k/m)/(2 pi) in Hz and the damping ratio b/(2 sqrt(k m)), 1 where
        critically damped. Both are NaN where k is negative; without a spring the frequency is 0 and the ratio
        NaN.
    """
    mass, k, b = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (mass, k, b)))
    with np.errstate(all="ignore"):
        frequency = np.sqrt(k / mass) / (2.0 * np.pi)
        ratio = np.where(k == 0.0, np.nan, b / (2.0 * np.sqrt(k * mass)))
    return frequency[()], ratio[()]
