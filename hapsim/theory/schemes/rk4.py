"""The classical Runge-Kutta scheme: every motion's exp(s T) becomes R(s T), R(z) = 1 + z + z²/2 + z³/6 + z⁴/24.

Undamped, |R(i y)|² = 1 - y⁶/72 + y⁸/576, which is below 1 up to y = omega T = 2 sqrt(2); and the angle of R(i y) is
y - y⁵/120 + ... A real s T has to stay above -2.785.

A damped oscillator has two z with the sum -b and the product k, b = B T/m, k = K T²/m. Where they are conjugate, both
|R(z)| are the root of R(z) R(z*), a polynomial of degree four in k. Where b is above 2.785, they are stable only from
some stiffness on.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.schemes.scheme import Advance, Polynomial, SchemeModel, at_every_instant, step_by

REAL_LIMIT = 2.785293563405282  # -z where R(z) = 1


def _advance(z: Any, start: Any) -> Any:
    """Arrays, or sparse matrices of scipy, both."""
    return start + z @ (start + z @ (start + z @ (start + z @ start / 4.0) / 3.0) / 2.0)


def _stiffness_limit(mass: float, damping: float, period: float) -> float:
    b = damping * period / mass
    if b >= 2.0 * REAL_LIMIT:
        return 0.0
    square = _square_of_growth(b)
    square[0] -= 1.0
    roots = np.polynomial.polynomial.polyroots(square)
    conjugate = max(0.25 * b * b, 1e-9)  # from here on; below, one of the motions may be too fast, but no k makes it so
    crossings = [root.real for root in roots if abs(root.imag) < 1e-9 * abs(root) and root.real > conjugate]
    return float(min(crossings)) * mass / period**2


def _square_of_growth(b: float) -> Floats:
    """R(z) R(z*) as a polynomial in k = z z*, lowest power first, where z + z* = -b."""
    inverse = [1.0 / math.factorial(i) for i in range(5)]
    # Sums of powers z^m + z*^m, by p_m = -b p_(m-1) - k p_(m-2).
    sums = [np.array([2.0]), np.array([-b])]
    for _ in range(3):
        sums.append(np.polynomial.polynomial.polysub(-b * sums[-1], np.polynomial.polynomial.polymulx(sums[-2])))
    square = np.zeros(5)
    for i in range(5):
        square[i] += inverse[i] ** 2
        for j in range(i + 1, 5):
            power = sums[j - i]
            square[i : i + power.size] += inverse[i] * inverse[j] * power
    return square


RK4 = SchemeModel(
    step_by(_advance),
    _stiffness_limit,
    order=4,
    error=-1.0 / 120.0,
    advance=Advance(_advance, at_every_instant, Polynomial()),
)
