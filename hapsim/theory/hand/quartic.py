"""A first guess at the slow pair of poles: closed forms of cubics and quartics (Cardano, Ferrari), for many at once.

Good to about a part in 1e15 of the largest root; what is much slower than that is found from the lowest terms alone.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.hand.pole_pair import PolePair

SLOW = 1e-3  # roots so close to w = 0 are those of the three lowest terms, to as good a guess as any


def guess_of_slow_factor(coefficients: list[Floats]) -> tuple[Floats, Floats]:
    """(p, q) near a factor w² + p w + q with the slowest poles, of a polynomial in w, lowest power first.

    Of a polynomial of higher degree the five lowest terms are taken.
    """
    constant, linear, square = coefficients[:3]
    p, q = linear / square, constant / square
    slow = np.abs(p) + np.sqrt(np.abs(q)) < SLOW
    if slow.all():
        return p, q
    lowest = coefficients[:5]
    if len(coefficients) > 5:
        lowest = [coefficient / lowest[-1] for coefficient in lowest]
    far_p, far_q = _of_quartic(*lowest[:4]) if len(lowest) == 5 else _of_cubic(*lowest[:3])
    return np.where(slow, p, far_p), np.where(slow, q, far_q)


def _of_quartic(d: Floats, c: Floats, b: Floats, a: Floats) -> tuple[Floats, Floats]:
    """w⁴ + a w³ + b w² + c w + d: the slower of two real factors, by the sum of their constant terms."""
    y = _largest_root(-b, a * c - 4.0 * d, 4.0 * b * d - a * a * d - c * c)
    apart = np.sqrt(np.maximum(0.25 * a * a - b + y, 0.0))
    between = np.copysign(np.sqrt(np.maximum(0.25 * y * y - d, 0.0)), 0.5 * a * y - c)
    one, other = PolePair(0.5 * a + apart, 0.5 * y + between), PolePair(0.5 * a - apart, 0.5 * y - between)
    slower = one.larger_modulus > other.larger_modulus
    return np.where(slower, one.p, other.p), np.where(slower, one.q, other.q)


def _of_cubic(c: Floats, b: Floats, a: Floats) -> tuple[Floats, Floats]:
    """w³ + a w² + b w + c without its most negative root, the fastest of real poles."""
    root = -_largest_root(-a, b, -c)
    p = a + root
    return p, b + root * p


def _largest_root(a: Floats, b: Floats, c: Floats) -> Floats:
    """The largest real root of y³ + a y² + b y + c."""
    third = a / 3.0
    q = third * third - b / 3.0
    r = third * (third * third - 0.5 * b) + 0.5 * c
    bend = r * r - q * q * q
    size = np.sqrt(np.maximum(q, 0.0))
    three = -2.0 * size * np.cos((np.arccos(np.clip(r / (size * q + 1e-300), -1.0, 1.0)) + 2.0 * np.pi) / 3.0)
    # The cube root by logarithms, which take a tenth of its time.
    cube = -np.copysign(np.exp(np.log(np.abs(r) + np.sqrt(np.maximum(bend, 0.0)) + 1e-300) / 3.0), r)
    one = cube + q / cube
    return np.where(bend < 0.0, three, one) - third
