"""What a scheme makes of a linear system from one sample to the next, by the scene's names for the schemes.

A system is M x'' + B x' + K x = 0 with M a vector of masses and symmetric B and K. Its state is (x, v), where x is in m
and v, in m/s, is what a link feels between two samples: under CORDIS's scheme (x[n] - x[n-1])/T, under the others their
own velocity. The rest of the theory reads a scheme's properties and never its name.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats


class LinkNature(NamedTuple):
    """What a scheme needs to know of a link.

    Attributes:
        in_a_matrix: the link is a spring and a backward damper and nothing else.
        memoryless: its force depends on the positions and velocities of its ends and on nothing earlier.
        at_channel: one of its ends is a device channel.
    """

    in_a_matrix: bool
    memoryless: bool
    at_channel: bool


def in_a_matrix(link: LinkNature) -> bool:
    """Whether a scheme that works the scene into one matrix takes the link in."""
    return link.in_a_matrix and not link.at_channel


def at_every_instant(link: LinkNature) -> bool:
    """Whether a scheme that needs forces at several instants of a sample period can have this link's."""
    return link.memoryless


@dataclass(frozen=True)
class Polynomial:
    """A large scene's transition is `advance` of sparse matrices: `advance` consists of sums and products."""


@dataclass(frozen=True)
class Implicit:
    """A large scene's transition is sparse on either side: (1 - share A T) z[n+1] = (1 + (1 - share) A T) z[n]."""

    share: float


@dataclass(frozen=True)
class ByModes:
    """A large scene's transition is full and worked out mode by mode: `advance` takes stacked rates (..., N, N)."""


class Advance(NamedTuple):
    """How a scheme other than CORDIS's moves a system, which links it does that with, and how it does it for many.

    Attributes:
        advance: what becomes in a sample of any z whose rates of change are A z: (N, N) T A, (N, n) of several z ->
            (N, n).
        inside: whether a link is asked for its force between two samples, as in the kernel. The force of any other
            link is held from sample to sample.
        large: how the transition of a large scene is kept.
    """

    advance: Callable[[Any, Any], Any]
    inside: Callable[[LinkNature], bool]
    large: Polynomial | Implicit | ByModes

    def __call__(self, rates: Any, start: Any) -> Any:
        return self.advance(rates, start)


class SchemeModel(NamedTuple):
    """A scheme.

    Attributes:
        step: (n,) masses in kg, (n, n) K in N/m, (n, n) B in N·s/m, T in s -> the matrix (2 n, 2 n) that takes (x, v)
            from sample to sample.
        stiffness_limit: m in kg, B in N·s/m, T in s -> the stiffness in N/m up to which a single oscillator is stable;
            infinity where it always is, 0 where it never is.
        order: p, and error: c, of the frequency that a weakly damped oscillator has: omega (1 + c (omega T)^p) for
            small omega T. Both are 0 where the frequency is exact.
        advance: None for CORDIS's scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n] for every mass.
    """

    step: Callable[[Floats, Floats, Floats, float], Floats]
    stiffness_limit: Callable[[float, float, float], float]
    order: int
    error: float
    advance: Advance | None


def spectral_radius(step: Floats) -> float:
    """The largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(step)).max(initial=0.0))


def step_by(advance: Callable[[Any, Any], Any]) -> Callable[[Floats, Floats, Floats, float], Floats]:
    """The ``step`` of a scheme that advances anything."""

    def step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
        n = mass.size
        rates = np.block([[np.zeros((n, n)), np.eye(n)], [-stiffness / mass[:, None], -damping / mass[:, None]]])
        return np.asarray(advance(period * rates, np.eye(2 * n)), float)

    return step


def always_stable(_mass: float, _damping: float, _period: float) -> float:
    """The stiffness limit of a scheme that has none: infinity."""
    return math.inf


# CORDIS: masses by the second-order centred difference, dampers by the backward one, explicit.
#
#     x[n+1] - 2 x[n] + x[n-1] = -T² M^-1 (K x[n] + B (x[n] - x[n-1])/T)
#
# With v[n] = (x[n] - x[n-1])/T it is v[n+1] = v[n] - T M^-1 (K x[n] + B v[n]), x[n+1] = x[n] + T v[n+1]: the
# semi-implicit Euler scheme is the same.
#
# A single oscillator, with a = K T²/m and b = B T/m, has z² - (2 - a - b) z + 1 - b = 0: both |z| < 1 where 0 < a and
# b < 2 and a + 2 b < 4. Undamped, cos(theta) = 1 - (omega T)²/2, so theta = omega T (1 + (omega T)²/24 + ...).


def _cordis_step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
    one = np.eye(mass.size)
    of_position = -period * stiffness / mass[:, None]
    of_velocity = one - period * damping / mass[:, None]
    return np.block([[one + period * of_position, period * of_velocity], [of_position, of_velocity]])


def _cordis_stiffness_limit(mass: float, damping: float, period: float) -> float:
    return max(0.0, 4.0 - 2.0 * damping * period / mass) * mass / period**2


CORDIS = SchemeModel(_cordis_step, _cordis_stiffness_limit, order=2, error=1.0 / 24.0, advance=None)


# Midpoint: z[n+1] = z[n] + T A (z[n] + z[n+1])/2, with A the rates of change.
#
# Every motion's exp(s T) becomes (1 + s T/2)/(1 - s T/2), which is within the circle wherever s is left of the
# imaginary axis. Undamped, tan(theta/2) = omega T/2, so theta = omega T (1 - (omega T)²/12 + ...).


def _midpoint(rates: Floats, start: Floats) -> Floats:
    half = 0.5 * rates
    return np.asarray(np.linalg.solve(np.eye(len(half)) - half, start + half @ start), float)


MIDPOINT = SchemeModel(
    step_by(_midpoint), always_stable, 2, -1.0 / 12.0, Advance(_midpoint, in_a_matrix, Implicit(0.5))
)


# Exact: exp(A T), with A the rates of change.


def _exact(rates: Floats, start: Floats) -> Floats:
    from scipy.linalg import expm

    after: Floats = expm(rates) @ start
    return after


EXACT = SchemeModel(step_by(_exact), always_stable, 0, 0.0, Advance(_exact, in_a_matrix, ByModes()))


# RK4, the classical Runge-Kutta scheme: every motion's exp(s T) becomes R(s T), R(z) = 1 + z + z²/2 + z³/6 + z⁴/24.
#
# Undamped, |R(i y)|² = 1 - y⁶/72 + y⁸/576, which is below 1 up to y = omega T = 2 sqrt(2); and the angle of R(i y) is
# y - y⁵/120 + ... A real s T has to stay above -2.785.
#
# A damped oscillator has two z with the sum -b and the product k, b = B T/m, k = K T²/m. Where they are conjugate, both
# |R(z)| are the root of R(z) R(z*), a polynomial of degree four in k. Where b is above 2.785, they are stable only from
# some stiffness on.

RK4_REAL_LIMIT = 2.785293563405282  # -z where R(z) = 1


def _rk4(z: Any, start: Any) -> Any:
    """Of arrays, or of scipy's sparse matrices."""
    return start + z @ (start + z @ (start + z @ (start + z @ start / 4.0) / 3.0) / 2.0)


def _rk4_stiffness_limit(mass: float, damping: float, period: float) -> float:
    b = damping * period / mass
    if b >= 2.0 * RK4_REAL_LIMIT:
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


RK4 = SchemeModel(step_by(_rk4), _rk4_stiffness_limit, 4, -1.0 / 120.0, Advance(_rk4, at_every_instant, Polynomial()))

SCHEMES: dict[str, SchemeModel] = {
    "cordis": CORDIS,
    "semi_implicit": CORDIS,
    "midpoint": MIDPOINT,
    "rk4": RK4,
    "exact": EXACT,
}
