"""Virtual coupling: a spring Kc and a damper Bc between the hand and a scene, so that no scene behind them is unstable.

Colgate, Stanley and Brown (1995); Adams and Hannaford (1999). The scene behind the coupling is passive in the backward
difference: walls, dampers, friction, masses with an implicit step. Zc = Bc + Kc T/(1 - 1/z) is the impedance of the
coupling, b0 the device's friction, d the whole delay behind a zero-order hold. Every passive hand is stable if

    b0 >= (1 - cos((1 + d) theta)) / (2 Re(1/Zc)),  0 < theta <= pi

With kappa = Kc T/2, B = Bc + kappa and u = sin²(theta/2), the right side is the polynomial q(u) (B² u + kappa² (1 -
u))/(2 B), where u q(u) = 1 - cos((1 + d) theta). For a hand of known mass, P being the device's sampled position per
force, it is enough that

    Re(1/Zc) + Re((1 - 1/z) z^-d P)/T > 0
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import polynomial
from numpy.polynomial.chebyshev import cheb2poly
from scipy.optimize import brentq, minimize_scalar

from hapsim.theory.arrays import Floats
from hapsim.theory.device_step import device_step
from hapsim.theory.hand.configuration import Configuration

_THETA, _ZOOMS = math.pi * np.geomspace(1e-3, 1.0, 400), 5
_DAMPINGS = np.geomspace(1e-3, 1.0, 30)  # of m/T, where a search begins
_CLOSE = 1e-13  # of a value that is sought


class Coupling(NamedTuple):
    """A spring and a damper between hand and scene."""

    stiffness: float
    """Kc, N/m."""
    damping: float
    """Bc, N·s/m."""


def needed_friction(coupling: Coupling, period: float, delay: int) -> float:
    """Returns the device's friction, N·s/m, from which on any hand and any passive scene are stable.

    `period`: T, s; `delay`: whole sample periods, 0 or more."""
    kappa = 0.5 * coupling.stiffness * period
    if not kappa > 0.0:
        return coupling.damping
    return kappa * _most(1.0 + coupling.damping / kappa, delay)[0]


def stiffest_coupling(friction: float, period: float, delay: int) -> Coupling:
    """Returns the coupling with the largest Kc that this friction, N·s/m, makes stable for any hand and passive scene.
    The other arguments are those of `needed_friction`."""
    ratio = 1.0
    if _slope(1.0, delay) < 0.0:
        ratio = brentq(_slope, 1.0, 10.0 * (1.0 + delay), args=(delay,), xtol=1e-15)
    kappa = friction / _most(ratio, delay)[0]
    return Coupling(2.0 * kappa / period, (ratio - 1.0) * kappa if delay else 0.0)


def stiffest_for(hands: Sequence[Configuration]) -> Coupling | None:
    """Returns the coupling with the largest Kc that is stable for each of these hands and any passive scene; None if
    none is found. The hands differ in nothing but their mass."""
    unit, period = hands[0].damping_unit, hands[0].period

    def stiffness(damping: float) -> float:
        return min(_stiffest_at(hand, damping) for hand in hands)

    tried = [stiffness(unit * share) for share in _DAMPINGS]
    best = int(np.argmax(tried))
    if not tried[best] > 0.0:
        return None
    ends = unit * _DAMPINGS[max(best - 1, 0)], unit * _DAMPINGS[min(best + 1, _DAMPINGS.size - 1)]
    found = minimize_scalar(lambda damping: -stiffness(damping), bounds=ends, method="bounded", options={"xatol": 1e-9})
    return Coupling(2.0 * stiffness(found.x) / period, float(found.x))


def _stiffest_at(hand: Configuration, damping: float) -> float:
    """Returns the largest kappa at this Bc; 0 if there is none."""

    def room(kappa: float) -> float:
        total, theta = damping + kappa, _THETA
        for _ in range(_ZOOMS):
            given = total / (total**2 + (kappa / np.tan(0.5 * theta)) ** 2) + _kept(hand, theta)
            least = int(np.argmin(given))
            theta = np.linspace(theta[max(least - 1, 0)], theta[min(least + 1, theta.size - 1)], 65)
        return float(given[least])

    most = hand.stiffness_unit * hand.period
    if not room(1e-9 * most) > 0.0:
        return 0.0
    if room(10.0 * most) > 0.0:
        return 10.0 * most
    return float(brentq(room, 1e-9 * most, 10.0 * most, xtol=_CLOSE * most))


def _kept(hand: Configuration, theta: Floats) -> Floats:
    """Returns Re((1 - 1/z) z^-d P)/T, m/(N s), at theta (n,): below 0 the late device gives energy."""
    c = hand
    step = device_step(c.friction / c.damping_unit, c.delay, c.hold, c.stiffness / c.stiffness_unit, c.sampling)
    motion, forces = step.moves
    z = np.exp(1j * theta)
    pushed = forces @ z[None, :] ** -np.arange(forces.shape[1])[:, None]
    (a, b), (p, q) = motion[:2]
    position = ((z - q) * pushed[0] + b * pushed[1]) / ((z - a) * (z - q) - b * p)
    unit = c.period**2 / c.mass
    return np.asarray(((1.0 - 1.0 / z) * position).real * unit / c.period)


@cache
def _demand(delay: int) -> Floats:
    """Returns the coefficients of q(u), of increasing powers."""
    late = polynomial.Polynomial(cheb2poly([0.0] * (1 + delay) + [1.0]))
    whole = 1.0 - late(polynomial.Polynomial([1.0, -2.0]))
    return np.asarray(whole.coef[1:])


def _most(ratio: float, delay: int) -> tuple[float, float]:
    """Returns the needed friction over kappa for B/kappa = `ratio`, and the u that needs it."""
    needed = polynomial.polymul(_demand(delay), [1.0, ratio**2 - 1.0]) / (2.0 * ratio)
    roots = polynomial.polyroots(polynomial.polyder(needed))
    inner = roots.real[(np.abs(roots.imag) < 1e-9) & (roots.real > 0.0) & (roots.real < 1.0)]
    u = np.concatenate([[0.0, 1.0], inner])
    values = polynomial.polyval(u, needed)
    at = int(np.argmax(values))
    return float(values[at]), float(u[at])


def _slope(ratio: float, delay: int) -> float:
    """Returns the derivative of `_most` by the ratio: that at the u that needs the friction."""
    _, u = _most(ratio, delay)
    return float(polynomial.polyval(u, _demand(delay))) * (u - (1.0 - u) / ratio**2)
