"""Functions on a pair of poles, kept accurate where the two poles meet.

Two real conditions hold at a pair of poles, whether the two are complex conjugates, two real numbers or one
double number. In terms of the values at the two alone the last case is lost. In terms of one value and the
divided difference (f(w1) - f(w2))/(w1 - w2), carried along by the rules of products and quotients and never
by that quotient, the three cases are one, to full accuracy: a divided difference of conjugates is Im f/Im w,
of equals the derivative.

The variable is w = z - 1, not z: slow poles, close to z = 1, keep all their digits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats


class OnPair(NamedTuple):
    """A function's values at the pole nearer to z = 1 and at the other one, and its divided difference."""

    near: Complexes
    far: Complexes
    slope: Complexes

    def plus(self, constant: complex | Complexes) -> OnPair:
        """The function plus a constant."""
        return OnPair(self.near + constant, self.far + constant, self.slope)

    def times(self, other: OnPair) -> OnPair:
        """The product of two functions."""
        slope = self.near * other.slope + self.slope * other.far
        return OnPair(self.near * other.near, self.far * other.far, slope)

    def over(self, other: OnPair) -> OnPair:
        """The quotient of two functions."""
        near = self.near / other.near
        return OnPair(near, self.far / other.far, (self.slope - near * other.slope) / other.far)

    def power(self, exponent: int) -> OnPair:
        """The function raised to an integer >= 0."""
        result = constant_like(self, 1.0)
        square = self
        while exponent:
            if exponent % 2:
                result = result.times(square)
            square = square.times(square)
            exponent //= 2
        return result

    def polynomial(self, coefficients: Floats) -> OnPair:
        """The polynomial of the function with scalar coefficients, highest power first."""
        result = constant_like(self, coefficients[0])
        for coefficient in coefficients[1:]:
            result = result.times(self).plus(coefficient)
        return result


def constant_like(function: OnPair, value: complex | Floats) -> OnPair:
    """The constant function, of the same shape; an array of constants where the pairs have one each."""
    constant = np.full_like(function.near, value)
    return OnPair(constant, constant, np.zeros_like(constant))


def pair_of_quadratic(p: Floats, q: Floats) -> OnPair:
    """The identity w on the two roots of w² + p w + q."""
    near, far = _roots(p, q)
    return OnPair(near, far, np.ones_like(near))


def pair_of_oscillator(sigma: Floats, kappa: Floats, damping: float) -> tuple[OnPair, OnPair]:
    """w and w + 1 - exp(-damping) on the poles w = e^s - 1 of s² + sigma s + kappa = 0, periods as time.

    The second is computed for itself: at the free mass's own decay, s = -damping, the sum would cancel.
    """
    near, far = _roots(sigma, kappa)
    ones = np.ones_like(near)
    from_decay_far = np.where(near.imag == 0.0, (damping - sigma) - near, far + damping)
    decayed = OnPair(-np.exp(near) * np.expm1(-(near + damping)), -np.exp(far) * np.expm1(-from_decay_far), ones)
    return OnPair(np.expm1(near), np.expm1(far), ones), decayed


def oscillator_of_quadratic(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """The (sigma, kappa) with s² + sigma s + kappa = 0 at s = ln(1 + w), of the roots of w² + p w + q.

    NaN where a real pole z = 1 + w is not positive: no motion in continuous time looks like it.
    """
    near, far = _roots(p, q)
    sigma = -np.log1p(q - p)
    angle = np.arctan2(near.imag, 1.0 + near.real)
    real = near.imag == 0.0
    kappa = np.where(real, np.log1p(near.real) * np.log1p(far.real), (0.5 * sigma) ** 2 + angle**2)
    good = ~real | ((near.real > -1.0) & (far.real > -1.0))
    return np.where(good, sigma, np.nan), np.where(good, kappa, np.nan)


def _roots(p: Floats, q: Floats) -> tuple[Complexes, Complexes]:
    """The roots of x² + p x + q, the smaller first (for a complex pair the one above the real axis)."""
    half = 0.5 * p
    discriminant = half * half - q
    spread = np.sqrt(np.abs(discriminant))
    far = -(half + np.copysign(spread, half))
    near = np.divide(q, far, out=np.zeros_like(far), where=far != 0.0)
    is_complex = discriminant < 0.0
    near_pole = np.where(is_complex, -half + 1j * spread, near)
    return near_pole, np.where(is_complex, -half - 1j * spread, far)
