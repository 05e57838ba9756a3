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


CANCELS = 0.1  # a difference smaller than this part of its terms is worked out from small quantities


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


def pair_of_oscillator(sigma: Floats, kappa: Floats) -> OnPair:
    """The identity w on the poles w = e^s - 1 of s² + sigma s + kappa = 0, periods as time."""
    half = -0.5 * sigma
    bend = half * half - kappa
    spread = np.sqrt(np.abs(bend))
    is_complex = bend < 0.0
    far = half - np.copysign(spread, -half)
    near = np.divide(kappa, far, out=np.zeros_like(far), where=far != 0.0)
    # e^(a + jy) - 1 by real functions, several times as fast: (e^a - 1) + e^a (cos y - 1) + j e^a sin y.
    shrunk, angle = np.expm1(np.where(is_complex, half, near)), np.where(is_complex, 0.5 * spread, 0.0)
    sine = np.sin(angle)
    turned = np.empty(shrunk.shape, dtype=complex)
    turned.real = shrunk - 2.0 * (1.0 + shrunk) * sine * sine
    turned.imag = 2.0 * (1.0 + shrunk) * sine * np.cos(angle)
    other = np.where(is_complex, turned.conj(), np.expm1(np.where(is_complex, half, far)))
    return OnPair(turned, other, np.ones_like(turned))


def quadratic_of_oscillator(sigma: float, kappa: float) -> tuple[float, float]:
    """(p, q): the poles w = e^s - 1 of s² + sigma s + kappa = 0 are the roots of w² + p w + q."""
    w = pair_of_oscillator(np.array([sigma]), np.array([kappa]))
    return float(-(w.near + w.far).real[0]), float((w.near * w.far).real[0])


def change_of_quadratic(
    w: OnPair, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats], damping: float, stiffness: float
) -> tuple[Floats, Floats]:
    """(p, q) of the mass by itself, with its ``damping`` and ``stiffness``, less those of the pair ``w``.

    ``oscillator``: (sigma, kappa) of the pair. ``more``: (sigma - damping, kappa - stiffness), which the caller knows to
    all their digits: where the two oscillators are nearly the same, p and q cancel, and their changes are worked out
    from these.
    """
    own_p, own_q = quadratic_of_oscillator(damping, stiffness)
    p, q = -(w.near + w.far).real, (w.near * w.far).real
    p_change, q_change = own_p - p, own_q - q
    p_cancels = np.abs(p_change) < CANCELS * np.maximum(np.abs(p), own_p)
    q_cancels = np.abs(q_change) < CANCELS * np.maximum(np.abs(q), own_q)
    cancels = np.nonzero(p_cancels | q_cancels)
    if cancels[0].size:
        (sigma, kappa), (more_sigma, more_kappa) = ([value[cancels] for value in pair] for pair in (oscillator, more))
        careful = _small_change((sigma, kappa), (more_sigma, more_kappa), damping, stiffness)
        p_change[cancels] = np.where(p_cancels[cancels], careful[0], p_change[cancels])
        q_change[cancels] = np.where(q_cancels[cancels], careful[1], q_change[cancels])
    return p_change, q_change


def _small_change(
    oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats], damping: float, stiffness: float
) -> tuple[Floats, Floats]:
    """With e = exp(-sigma/2), u = kappa - sigma²/4, C(u) = cos(sqrt u): p = 2 - 2 e C and q = (1 - e)² + 2 e (1 - C)."""
    (sigma, kappa), (more_damping, more_stiffness) = oscillator, more
    u, u0 = kappa - 0.25 * sigma**2, stiffness - 0.25 * damping**2
    of_u = more_stiffness - 0.25 * more_damping * (sigma + damping)
    e, e0 = np.exp(-0.5 * sigma), np.exp(-0.5 * damping)
    of_e = e0 * np.expm1(-0.5 * more_damping)
    root, root0 = np.sqrt(u.astype(complex)), np.sqrt(complex(u0))
    cosine, cosine0 = np.cos(root).real, np.cos(root0).real
    of_cosine = -0.5 * of_u * (_sinc(0.5 * (root + root0)) * _sinc(0.5 * (root - root0))).real
    # e C - e0 C0 in two parts, the difference of the cosines with the smaller factor: it may be large where e is small.
    heavier = more_damping > 0.0
    p_change = 2.0 * np.where(heavier, of_e * cosine0 + e * of_cosine, of_e * cosine + e0 * of_cosine)
    cosine_less_1 = -2.0 * (np.sin(0.5 * root) ** 2).real
    slow = 2.0 * cosine_less_1 - np.expm1(-0.5 * sigma) - np.expm1(-0.5 * damping)
    return p_change, of_e * slow + 2.0 * e0 * of_cosine


def _sinc(x: Complexes) -> Complexes:
    """sin(x)/x."""
    return np.where(x == 0.0, 1.0, np.sin(x) / np.where(x == 0.0, 1.0, x))


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
