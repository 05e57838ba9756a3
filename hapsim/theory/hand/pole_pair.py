"""Functions on a pair of poles, accurate also where the two poles meet.

A pair is two complex conjugates, two real poles or one double pole, which its two values cannot describe. Modulo the
quadratic w² + p w + q whose roots they are, every function is a line, constant + slope w, with real coefficients. Its
slope is the divided difference of the two values: Im f/Im w for conjugates, the derivative for a double pole. Products
and quotients of lines are lines, so one code serves all three cases, to full accuracy and without complex numbers.

The variable is w = z - 1, not z: slow poles, close to z = 1, keep all their digits.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Bools, Complexes, Floats

CANCELS = 0.1  # a difference smaller than this part of its terms is computed from small quantities


class PolePair(NamedTuple):
    """Pair of poles as the roots of w² + p w + q; arrays of one shape."""

    p: Floats
    q: Floats

    @property
    def w(self) -> LinearOnPair:
        """Identity function on the pair."""
        return LinearOnPair(0.0, 1.0, self)

    @property
    def smaller_modulus(self) -> Floats:
        """Modulus |1 + w| of the faster pole."""
        bend, product = 0.25 * self.p * self.p - self.q, np.abs(1.0 - self.p + self.q)
        real = np.abs(1.0 - 0.5 * self.p) + np.sqrt(np.maximum(bend, 0.0))
        return product / np.where(bend < 0.0, np.sqrt(product), real)

    @property
    def poles(self) -> Complexes:
        """Poles z = 1 + w, (..., 2): the one nearer to 1 first, of conjugates the upper."""
        swings, spread, near, far = roots_of_quadratic(self.p, self.q)
        turn = 1j * np.where(swings, spread, 0.0)
        middle = -0.5 * self.p
        return 1.0 + np.stack([np.where(swings, middle, near) + turn, np.where(swings, middle, far) - turn], axis=-1)


class LinearOnPair(NamedTuple):
    """Function on a pair as a line modulo the pair's quadratic. Scalars stand for arrays of one value."""

    constant: Any
    slope: Any
    pair: PolePair

    def plus(self, constant: Any) -> LinearOnPair:
        """Returns the function plus a constant."""
        return LinearOnPair(self.constant + constant, self.slope, self.pair)

    def scaled(self, factor: Any) -> LinearOnPair:
        """Returns the function times a constant."""
        return LinearOnPair(self.constant * factor, self.slope * factor, self.pair)

    def times(self, other: LinearOnPair) -> LinearOnPair:
        """Returns the product of two functions."""
        (a, b, (p, q)), (c, d, _) = self, other
        square = b * d
        return LinearOnPair(a * c - square * q, a * d + b * c - square * p, self.pair)

    def over(self, other: LinearOnPair) -> LinearOnPair:
        """Returns the quotient of two functions."""
        (c, d, (p, q)) = other
        turned = c - d * p
        product = c * turned + d * d * q  # of the values at the two poles
        return self.times(LinearOnPair(turned / product, -d / product, self.pair))

    def power(self, exponent: int) -> LinearOnPair:
        """Returns the function raised to an integer >= 0."""
        if exponent == 0:
            return LinearOnPair(1.0, 0.0, self.pair)
        if exponent == 1:
            return self
        half = self.power(exponent // 2)
        return half.times(half).times(self) if exponent % 2 else half.times(half)

    def polynomial(self, coefficients: Floats) -> LinearOnPair:
        """Returns the polynomial of the function with scalar coefficients, highest power first."""
        result = LinearOnPair(float(coefficients[0]), 0.0, self.pair)
        for coefficient in coefficients[1:]:
            result = result.times(self).plus(float(coefficient))
        return result


def total(functions: list[LinearOnPair]) -> LinearOnPair:
    """Returns the sum of functions on one pair."""
    constants, slopes, pairs = zip(*functions, strict=True)
    return LinearOnPair(sum(constants), sum(slopes), pairs[0])


def roots_of_quadratic(p: Floats, q: Floats) -> tuple[Bools, Floats, Floats, Floats]:
    """Roots of x² + p x + q as (complex, spread, near, far): -p/2 ± j spread where complex, else near and far. The root
    ``near`` is the one closer to zero, to all its digits."""
    half = 0.5 * p
    bend = half * half - q
    spread = np.sqrt(np.abs(bend))
    far = -(half + np.copysign(spread, half))
    return bend < 0.0, spread, np.divide(q, far, out=np.zeros_like(far), where=far != 0.0), far


def pair_of_oscillator(sigma: Floats, kappa: Floats) -> PolePair:
    """Poles w = e^s - 1 of s² + sigma s + kappa = 0, periods as time."""
    is_complex, spread, near, far = roots_of_quadratic(sigma, kappa)
    # e^(a + jy) - 1 = (e^a - 1) + e^a (cos y - 1) + j e^a sin y
    one, angle = np.expm1(np.where(is_complex, -0.5 * sigma, near)), np.where(is_complex, 0.5 * spread, 0.0)
    other = np.expm1(np.where(is_complex, -0.5 * sigma, far))
    sine = np.sin(angle)
    twice = 2.0 * (1.0 + one) * sine
    real, imaginary = one - twice * sine, twice * np.cos(angle)
    return PolePair(
        -np.where(is_complex, 2.0 * real, one + other),
        np.where(is_complex, real * real + imaginary * imaginary, one * other),
    )


@lru_cache(maxsize=64)  # of one hand, for many oscillators
def quadratic_of_oscillator(sigma: float, kappa: float) -> tuple[float, float]:
    """Coefficients (p, q) of w² + p w + q, whose roots are the poles w = e^s - 1 of s² + sigma s + kappa = 0."""
    pair = pair_of_oscillator(np.array([sigma]), np.array([kappa]))
    return float(pair.p[0]), float(pair.q[0])


def change_of_quadratic(
    pair: PolePair, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats], damping: float, stiffness: float
) -> tuple[Floats, Floats]:
    """Returns (p, q) of the mass alone, with its ``damping`` and ``stiffness``, minus those of the ``pair``.
    ``oscillator``: (sigma, kappa) of the pair. ``more``: (sigma - damping, kappa - stiffness), which the caller knows
    to all their digits. Between nearly equal oscillators p and q cancel, so their changes are computed from
    ``more``."""
    own_p, own_q = quadratic_of_oscillator(damping, stiffness)
    p, q = pair
    p_change, q_change = own_p - p, own_q - q
    p_cancels = np.abs(p_change) < CANCELS * np.maximum(np.abs(p), own_p)
    q_cancels = np.abs(q_change) < CANCELS * np.maximum(np.abs(q), own_q)
    cancels = np.nonzero(p_cancels | q_cancels)
    if cancels[0].size:
        (sigma, kappa), (more_sigma, more_kappa) = ([value[cancels] for value in both] for both in (oscillator, more))
        careful = _small_change((sigma, kappa), (more_sigma, more_kappa), damping, stiffness)
        # Beside a damping that stops the mass within a sample p and q may be alike by chance: those are out of range.
        for change, is_small, small in ((p_change, p_cancels, careful[0]), (q_change, q_cancels, careful[1])):
            change[cancels] = np.where(is_small[cancels] & np.isfinite(small), small, change[cancels])
    return p_change, q_change


def _small_change(
    oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats], damping: float, stiffness: float
) -> tuple[Floats, Floats]:
    """Changes of p = 2 - 2 e C and q = (1 - e)² + 2 e (1 - C), with e = exp(-sigma/2), u = kappa - sigma²/4, C =
    cos(sqrt u)."""
    (sigma, kappa), (more_damping, more_stiffness) = oscillator, more
    u, u0 = kappa - 0.25 * sigma**2, stiffness - 0.25 * damping**2
    of_u = more_stiffness - 0.25 * more_damping * (sigma + damping)
    e, e0 = np.exp(-0.5 * sigma), np.exp(-0.5 * damping)
    of_e = e0 * np.expm1(-0.5 * more_damping)
    root, root0 = np.sqrt(u.astype(complex)), np.sqrt(complex(u0))
    cosine, cosine0 = np.cos(root).real, np.cos(root0).real
    of_cosine = -0.5 * of_u * (_sinc(0.5 * (root + root0)) * _sinc(0.5 * (root - root0))).real
    # e C - e0 C0 in two parts. The difference of the cosines gets the smaller factor: it may be large where e is small.
    heavier = more_damping > 0.0
    p_change = 2.0 * np.where(heavier, of_e * cosine0 + e * of_cosine, of_e * cosine + e0 * of_cosine)
    cosine_less_1 = -2.0 * (np.sin(0.5 * root) ** 2).real
    slow = 2.0 * cosine_less_1 - np.expm1(-0.5 * sigma) - np.expm1(-0.5 * damping)
    return p_change, of_e * slow + 2.0 * e0 * of_cosine


def _sinc(x: Complexes) -> Complexes:
    """Returns sin(x)/x."""
    return np.where(x == 0.0, 1.0, np.sin(x) / np.where(x == 0.0, 1.0, x))


def oscillator_of_quadratic(p: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Returns (sigma, kappa) of s² + sigma s + kappa = 0 at s = ln(1 + w), for the roots of w² + p w + q. NaN where a
    real pole z = 1 + w is not positive: no motion in continuous time matches it."""
    swings, spread, near, far = roots_of_quadratic(p, q)
    sigma = -np.log1p(q - p)
    swinging = (0.5 * sigma) ** 2 + np.arctan2(spread, 1.0 - 0.5 * p) ** 2
    kappa = np.where(swings, swinging, np.log1p(near) * np.log1p(far))
    good = swings | ((near > -1.0) & (far > -1.0))
    return np.where(good, sigma, np.nan), np.where(good, kappa, np.nan)


def frequency_and_ratio(mass: ArrayLike, k: ArrayLike, b: ArrayLike) -> tuple[Floats, Floats]:
    """Eigenfrequency and damping ratio of a real mass, spring and damper (Florens et al., §5).

    Args:
        mass: kg, > 0.
        k: stiffness, N/m. Arrays broadcast.
        b: damping, N·s/m.

    Returns:
        The undamped eigenfrequency sqrt(k/m)/(2 pi) in Hz and the damping ratio b/(2 sqrt(k m)), 1 for critical
        damping. Both are NaN if k is negative. Without a spring the frequency is 0 and the ratio NaN.
    """
    mass, k, b = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (mass, k, b)))
    with np.errstate(all="ignore"):
        frequency = np.sqrt(k / mass) / (2.0 * np.pi)
        ratio = np.where(k == 0.0, np.nan, b / (2.0 * np.sqrt(k * mass)))
    return frequency[()], ratio[()]
