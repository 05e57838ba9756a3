"""The filtered damper: the backward difference behind a first-order low-pass with a cutoff.

The low-pass keeps the poles of its continuous model, 1/(1 + s/(2 pi cutoff)): a step goes through it by the same
exponential, sample by sample.
"""

from __future__ import annotations

import math

from hapsim.theory.interface.shape import Damper


def filtered(cutoff: float) -> Damper:
    """v[n] = (1 - a) v[n-1] + a (y[n] - y[n-1])/T, a = 1 - exp(-cutoff); v/y = w a/(w + a).

    ``cutoff``: 2 pi times the cutoff frequency times the sample period.
    """
    a = -math.expm1(-cutoff)
    return Damper(
        numerator=(a,), denominator=(a, 1.0), delays=0, of_positions=(a, -a), of_velocities=(math.exp(-cutoff),)
    )
