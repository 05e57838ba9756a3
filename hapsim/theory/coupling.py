"""Virtual coupling: a spring Kc and a damper Bc between the hand and a scene, so that no scene behind them is unstable.

Colgate, Stanley and Brown (1995); Adams and Hannaford (1999). The scene behind the coupling is passive in the backward
difference: walls, dampers, friction, masses with an implicit step. Zc = Bc + Kc T/(1 - 1/z) is the impedance of the
coupling, b0 the device's friction. Every passive hand is stable if

    b0 >= (eta - Re w) / (2 Re(1/Zc)),  0 < theta <= pi

w and eta, the root mean square of h, are those of ``interface.Lag``. For all velocities of one size, the product of
reading and work fills an ellipse with the foci 0 and w and the axis eta. On it the size exceeds the real part by eta -
Re w at most. Behind a zero-order hold and d whole samples eta is 1 and w is exp(j (1 + d) theta).

With kappa = Kc T/2, B = Bc + kappa and u = sin²(theta/2), 1/Re(1/Zc) is (B² u + kappa² (1 - u))/(B u). That falls with
u, and the first lobe of eta - Re w is the highest: the most is needed there, before theta = pi over the mean lag of w.

For a hand of known mass let P be the device's sampled position per force, (1 - 1/z) z^-d P/T = N/D with polynomials in
1/z, and r its real part. It is enough that Re(1/Zc) + r > 0. So where r < 0, kappa must be below the larger root of

    r kappa² + u (1 + 2 r Bc) kappa + u Bc (1 + r Bc) = 0,  1 + r Bc > 0

Times |D|² the left side is a polynomial in u: positive for 0 < u <= 1 where it is at its stationary points and ends.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from scipy.optimize import brentq, minimize_scalar

from hapsim.theory.arrays import Floats
from hapsim.theory.device_step import DeviceStep, device_step
from hapsim.theory.hand.configuration import Configuration
from hapsim.theory.interface import Lag, lag_of

_NARROWER = 1000.0  # each interval of u from 0 on, in which stationary points are sought, than the one before
_AT_REST = 1e-30  # of u: there all is as at 0
_LONGEST = 100  # samples of delay: the search takes ten seconds
_FLAT = 1e-4  # of Bc: Kc is off by its square
_SOFTEST, _DAMPINGS = 1e-3, 30  # of m/T: dampings from there to 1, or from a tenth of the friction on, begin a search
_NEAR = 1e-3  # of the first lobe: a demand that peaks below is as large at 0, to 1e-12
_BELOW_NYQUIST = math.pi * (1.0 - 1e-7)
_CLOSE = 1e-13  # of a value that is sought


class Coupling(NamedTuple):
    """A spring and a damper between hand and scene."""

    stiffness: float
    """Kc, N/m."""
    damping: float
    """Bc, N·s/m."""


def needed_friction(coupling: Coupling, hand: Configuration) -> float:
    """Returns the device's friction, N·s/m, from which on any hand and any passive scene are stable. `hand`: its
    period, delay and hold count, which may not be by impulses."""
    kappa = 0.5 * coupling.stiffness * hand.period
    if not kappa > 0.0:
        return coupling.damping
    return kappa * _most(1.0 + coupling.damping / kappa, lag_of(hand.delay, hand.hold))[0]


def stiffest_coupling(hand: Configuration) -> Coupling:
    """Returns the coupling with the largest Kc that the friction of this device makes stable for any hand and passive
    scene. `hand`: as of `needed_friction`."""
    ratio, lag = 1.0, lag_of(hand.delay, hand.hold)
    if _slope(1.0, lag) < 0.0:
        ratio = brentq(_slope, 1.0, 10.0 * lag.lags[-1], args=(lag,), xtol=1e-15)
    kappa = hand.friction / _most(ratio, lag)[0]
    return Coupling(2.0 * kappa / hand.period, (ratio - 1.0) * kappa)


def stiffest_for(hands: Sequence[Configuration]) -> Coupling | None:
    """Returns the coupling with the largest Kc that is stable for each of these hands and any passive scene; None if
    none is found, or the delay is too long for the search. The hands differ in nothing but their mass."""
    if hands[0].delay > _LONGEST:
        return None
    unit, period = hands[0].damping_unit, hands[0].period

    def stiffness(damping: float) -> float:
        return min(_stiffest_at(hand, damping) for hand in hands)

    dampings = unit * np.geomspace(min(_SOFTEST, 0.1 * hands[0].friction / unit), 1.0, _DAMPINGS)
    tried = [stiffness(damping) for damping in dampings]
    best = int(np.argmax(tried))
    if not tried[best] > 0.0:
        return None
    ends = dampings[max(best - 1, 0)], dampings[min(best + 1, _DAMPINGS - 1)]
    close = {"xatol": _FLAT * ends[1]}
    found = minimize_scalar(lambda damping: -stiffness(damping), bounds=ends, method="bounded", options=close)
    kappa, damping = max((-float(found.fun), float(found.x)), (tried[best], float(dampings[best])))
    return Coupling(2.0 * kappa / period, damping)


def _stiffest_at(hand: Configuration, damping: float) -> float:
    """Returns the largest kappa at this Bc; 0 if there is none.

    It begins above and takes the least kappa that is allowed at any stationary point of the polynomial with the kappa
    before, until the polynomial is nowhere negative. The points are roots in the Chebyshev basis, in ever narrower
    intervals of u from 0 on, since a hand with little friction has some at very low frequencies.
    """
    least = min(hand.friction / hand.damping_unit, math.sqrt(hand.stiffness / hand.stiffness_unit) or 1.0, 1.0)
    narrowing = math.ceil(math.log(1e3 / least**2, _NARROWER))
    degree = _step_of(hand).forces.shape[1] + 4
    nodes = chebyshev.chebpts1(1 + degree)
    tops = _NARROWER ** -np.arange(narrowing + 1.0)
    u = tops[:, None] * (0.5 + 0.5 * nodes)
    late, weight = _given(hand, u)
    kappa, most = math.inf, _allowed(hand, damping, np.append(u, [_AT_REST, 1.0]))
    while 0.0 < most < kappa * (1.0 - _CLOSE):
        kappa = most
        room = late * kappa**2 + u * (weight + 2.0 * late * damping) * kappa + u * damping * (weight + late * damping)
        scaled = room / np.abs(room).max(axis=1, keepdims=True)
        roots = [chebyshev.chebroots(chebyshev.chebder(one)) for one in chebyshev.chebfit(nodes, scaled.T, degree).T]
        inner = [top * (0.5 + 0.5 * np.clip(one.real, -1.0, 1.0)) for top, one in zip(tops, roots, strict=True)]
        most = min(kappa, _allowed(hand, damping, np.concatenate(inner)))
    return most


def _allowed(hand: Configuration, damping: float, u: Floats) -> float:
    """Returns the largest kappa at this Bc that is allowed at every u (n,), at most ten times m/T."""
    late, weight = _given(hand, np.maximum(u, _AT_REST))
    r, most = late / weight, 10.0 * hand.stiffness_unit * hand.period
    bad = r < 0.0
    r, u = r[bad], np.maximum(u, _AT_REST)[bad]
    if not (1.0 + r * damping > 0.0).all():
        return 0.0
    half = u * (0.5 + r * damping)
    return float(np.min((half + np.sqrt(half**2 - r * u * damping * (1.0 + r * damping))) / -r, initial=most))


def _step_of(hand: Configuration) -> DeviceStep:
    friction, stiffness = hand.friction / hand.damping_unit, hand.stiffness / hand.stiffness_unit
    return device_step(friction, hand.delay, hand.hold, stiffness, hand.sampling)


def _given(hand: Configuration, u: Floats) -> tuple[Floats, Floats]:
    """Returns Re(N D*), whose sign is that of r, and |D|², at u: below 0 the late device gives energy. In terms of
    1 - 1/z, so that slow motions keep their digits."""
    motion, forces = _step_of(hand)
    change = 2.0 * u + 2j * np.sqrt(u * (1.0 - u))
    later = 1.0 - change
    pushed = [np.polyval(row[::-1], later) for row in forces[:3]]
    (a, b), (p, q), (of_position, of_velocity) = motion[:3]
    own, swift = change - a * later, change - q * later
    whole = own * swift - b * p * later**2
    position = later * (swift * pushed[0] + b * later * pushed[1])
    velocity = later * (own * pushed[1] + p * later * pushed[0])
    lead = later * (of_position * position + of_velocity * velocity + pushed[2] * whole)
    read = change * (position - lead)
    return (read.real * whole.real + read.imag * whole.imag) * hand.period / hand.mass, np.abs(whole) ** 2


def _lacks(lag: Lag, theta: float) -> tuple[float, float]:
    """Returns eta - Re w and its derivative. It keeps its digits near 0."""
    less = 2.0 * float(lag.products @ np.sin(0.5 * lag.apart * theta) ** 2)
    eta = math.sqrt(1.0 - less)
    size = 2.0 * float(lag.weights @ np.sin(0.5 * lag.lags * theta) ** 2) - less / (1.0 + eta)
    slope = float(lag.lags * lag.weights @ np.sin(lag.lags * theta))
    return size, slope - 0.5 * float(lag.apart * lag.products @ np.sin(lag.apart * theta)) / eta


def _most(ratio: float, lag: Lag) -> tuple[float, float]:
    """Returns the needed friction over kappa for B/kappa = `ratio`, and the u that needs it."""

    def rises(theta: float) -> float:
        u, (size, slope) = math.sin(0.5 * theta) ** 2, _lacks(lag, theta)
        return slope * u * (1.0 + (ratio**2 - 1.0) * u) - 0.5 * math.sin(theta) * size

    mean = float(lag.lags @ lag.weights)
    # Beyond the peak of the first lobe, or all but at half the rate, where the demand is level.
    end = min(math.pi / float(lag.lags[0]), 1.5 * math.pi / mean, _BELOW_NYQUIST)
    theta = math.pi
    if mean > 1.0:
        if not rises(_NEAR * end) > 0.0:
            return float(lag.lags**2 @ lag.weights - 0.5 * lag.apart**2 @ lag.products) / ratio, 0.0
        if rises(end) < 0.0:
            theta = brentq(rises, _NEAR * end, end, xtol=1e-15)
    u = math.sin(0.5 * theta) ** 2
    return _lacks(lag, theta)[0] * (ratio**2 * u + 1.0 - u) / (2.0 * ratio * u), u


def _slope(ratio: float, lag: Lag) -> float:
    """Returns the sign of the derivative of `_most` by the ratio: that at the u that needs the friction."""
    _, u = _most(ratio, lag)
    return u - (1.0 - u) / ratio**2
