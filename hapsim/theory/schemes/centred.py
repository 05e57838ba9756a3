"""CORDIS's scheme: masses by the second-order centred difference, dampers by the backward one, explicit.

    x[n+1] - 2 x[n] + x[n-1] = -T² M^-1 (K x[n] + B (x[n] - x[n-1])/T)

With v[n] = (x[n] - x[n-1])/T it is v[n+1] = v[n] - T M^-1 (K x[n] + B v[n]), x[n+1] = x[n] + T v[n+1]: the
semi-implicit Euler scheme is the same.

A single oscillator, with a = K T²/m and b = B T/m, has z² - (2 - a - b) z + 1 - b = 0: both |z| < 1 where 0 < a and
b < 2 and a + 2 b < 4. Undamped, cos(theta) = 1 - (omega T)²/2, so theta = omega T (1 + (omega T)²/24 + ...).
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.schemes.scheme import SchemeModel


def _step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
    one = np.eye(mass.size)
    of_position = -period * stiffness / mass[:, None]
    of_velocity = one - period * damping / mass[:, None]
    return np.block([[one + period * of_position, period * of_velocity], [of_position, of_velocity]])


def _stiffness_limit(mass: float, damping: float, period: float) -> float:
    return max(0.0, 4.0 - 2.0 * damping * period / mass) * mass / period**2


CORDIS = SchemeModel(_step, _stiffness_limit, order=2, error=1.0 / 24.0, advance=None)
SEMI_IMPLICIT = CORDIS
