"""Real quadratic factors of many polynomials at once, by Bairstow's method: roots without eigenvalues.

Polynomials are in powers of w = z - 1, lowest first, one array for each coefficient: what is slow lies close to w = 0,
where such a polynomial keeps all its digits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.hand.pole_pair import roots_of_quadratic
from hapsim.theory.hand.quartic import guess_of_slow_factor

MOST_STEPS = 14
MOST_FROM_CLOSED_FORM = 5  # where the guess is a solution but for rounding: what does not settle then never does
TOGETHER = 1  # steps that all points take; then those that have arrived stay behind
ARRIVED = 1e-10  # relative size of a step: Newton's next one would be its square
GOOD_ENOUGH = 1e-9  # the same: two poles that nearly meet do not settle any better


class Factors(NamedTuple):
    """``p``, ``q`` of the factors w² + p w + q, each (n,), the slow ones first; ``single``: a root left over, or None.

    ``found`` (n,): where the method arrived. Elsewhere the factors are none.
    """

    p: list[Floats]
    q: list[Floats]
    single: Floats | None
    found: Bools


def quadratic_factors(coefficients: list[Floats], known: tuple[Floats, Floats, Bools] | None = None) -> Factors:
    """The factors of monic polynomials of degree 2 and more. ``known``: a slow one, if it has been found already."""
    p: list[Floats] = []
    q: list[Floats] = []
    found = np.isfinite(sum(coefficients))
    if known is not None and len(coefficients) > 3:
        p, q, found = [known[0]], [known[1]], found & known[2]
        coefficients = divided(coefficients, p[0], q[0])[2:]
    while len(coefficients) > 3:
        one_p, one_q, arrived = slow_factor(coefficients)
        coefficients = divided(coefficients, one_p, one_q)[2:]
        found &= arrived
        p.append(one_p)
        q.append(one_q)
    if len(coefficients) == 2:
        return Factors(p, q, -coefficients[0], found)
    return Factors([*p, coefficients[1]], [*q, coefficients[0]], None, found)


class Roots(NamedTuple):
    """Real and imaginary parts of all N roots, (N, n); the two of a complex pair side by side, the upper one first."""

    real: Floats
    imaginary: Floats


def roots_of_factors(factors: Factors) -> Roots:
    """All roots w."""
    pairs = len(factors.p)
    count = 2 * pairs + (factors.single is not None)
    real, imaginary = np.zeros((count, factors.found.size)), np.zeros((count, factors.found.size))
    for i, (p, q) in enumerate(zip(factors.p, factors.q, strict=True)):
        swings, spread, near, far = roots_of_quadratic(p, q)
        real[2 * i] = np.where(swings, -0.5 * p, near)
        real[2 * i + 1] = np.where(swings, -0.5 * p, far)
        imaginary[2 * i] = np.where(swings, spread, 0.0)
        imaginary[2 * i + 1] = -imaginary[2 * i]
    if factors.single is not None:
        real[-1] = factors.single
    return Roots(real, imaginary)


def slow_factor(coefficients: list[Floats]) -> tuple[Floats, Floats, Bools]:
    """(p, q, whether it arrived): one factor of each polynomial, of its slowest roots, mostly."""
    p, q = guess_of_slow_factor(coefficients)
    for _ in range(TOGETHER):
        dp, dq = _step(coefficients, p, q)
        p, q = p + dp, q + dq
    size = _size_of_step(p, q, dp, dq)
    for _ in range((MOST_STEPS if len(coefficients) > 5 else MOST_FROM_CLOSED_FORM) - TOGETHER):
        under_way = np.flatnonzero(~(size <= ARRIVED))
        if under_way.size == 0:
            break
        some = [coefficient[under_way] for coefficient in coefficients]
        dp, dq = _step(some, p[under_way], q[under_way])
        p[under_way] += dp
        q[under_way] += dq
        before = size[under_way]
        size[under_way] = now = _size_of_step(p[under_way], q[under_way], dp, dq)
        # Rounding has the last word: a step that no longer shrinks will not.
        size[under_way[(now >= 0.5 * before) & (now <= GOOD_ENOUGH)]] = 0.0
    return p, q, size <= GOOD_ENOUGH


def _size_of_step(p: Floats, q: Floats, dp: Floats, dq: Floats) -> Floats:
    """Relative to the roots' own size; NaN where a polynomial is not finite."""
    root = np.abs(p) + np.sqrt(np.abs(q))
    return np.maximum(np.abs(dp) / (root + 1e-300), np.abs(dq) / (np.abs(q) + 1e-300))


def _step(coefficients: list[Floats], p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Newton's step for (p, q): the remainder of a division, and by a second division how it changes."""
    b = divided(coefficients, p, q)
    f = divided(b[1:], p, q)  # one short: f[i] goes with b[i + 1]
    determinant = f[1] * f[1] - f[0] * f[2]
    return (b[1] * f[1] - b[0] * f[2]) / determinant, (b[0] * f[1] - b[1] * f[0]) / determinant


def in_z(coefficients: list[Floats]) -> list[Floats]:
    """A polynomial in w = z - 1, lowest power first, in powers of z, highest first."""
    shifted = coefficients[::-1]
    for last in range(len(shifted), 1, -1):
        for i in range(1, last):
            shifted[i] = shifted[i] - shifted[i - 1]
    return shifted


def divided(coefficients: list[Floats], p: Floats, q: Floats) -> list[Floats]:
    """A monic polynomial by w² + p w + q: the quotient from the third entry on, and before it what is left."""
    one, before = coefficients[-1], coefficients[-2] - p
    result = [one, before]
    if len(coefficients) > 2:
        result.append(coefficients[-3] - p * before - q)
    for coefficient in reversed(coefficients[:-3]):
        result.append(coefficient - p * result[-1] - q * result[-2])
    return result[::-1]
