"""Inverse map: the simulated element that the hand feels as a given oscillator (the paper's Figure 4, in closed form).

From it follow the stability boundary, the curve b = 0 (Florens et al., §6.2), and the stable interval of K or of B.
Units are normalised, with periods as time: from sigma and kappa of s² + sigma s + kappa to K T²/m and B T/m. On the
curve the hand feels an oscillator without damping, s = j theta, with theta its frequency in radians per sample. A real
pole may also leave the unit circle at z = 1 (a negative total stiffness) or at z = -1.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.hand.lone_hand import LoneHand, Relation, characteristic, element_of_relation, relation_on_pair
from hapsim.theory.hand.pole_pair import PolePair, change_of_quadratic, pair_of_oscillator
from hapsim.theory.hand.poles import all_within, roots, without_pair

FASTEST = 10.0  # decay in a sample period; above, the double pole is lost in the rounding of the others


def element_of_oscillator(
    hand: LoneHand, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]
) -> tuple[Floats, Floats, PolePair]:
    """Returns (K T²/m, B T/m, the pair of poles); not finite where an element cannot distinguish the two poles.
    ``oscillator``: (sigma, kappa). ``more``: the same without the device's own friction and spring. It is separate
    because the small part that the element adds would be lost in the sum."""
    relation = relation_of_oscillator(hand, oscillator, more)
    return *element_of_relation(hand, relation), relation[0].pair


def relation_of_oscillator(hand: LoneHand, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]) -> Relation:
    """Returns ``relation_on_pair`` for the oscillator's poles."""
    pair = pair_of_oscillator(*oscillator)
    return relation_on_pair(hand, pair, change_of_quadratic(pair, oscillator, more, hand.damping, hand.stiffness))


def undamped(hand: LoneHand, theta: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """Returns ``oscillator`` and ``more`` of an oscillation of theta radians per sample without damping."""
    zero = np.zeros_like(theta)
    return (zero, theta**2), (zero - hand.damping, theta**2 - hand.stiffness)


def is_attainable(sigma: Floats | float, kappa: Floats | float) -> Bools:
    """Returns whether the oscillator's frequency is below the Nyquist frequency."""
    with np.errstate(over="ignore"):
        return np.asarray(kappa - 0.25 * np.square(sigma) < np.pi**2)


def leads(hand: LoneHand, stiffness: Floats, damping: Floats, pair: PolePair) -> Bools:
    """Returns whether every other pole of the loop decays faster than both of the pair."""
    others = without_pair(characteristic(hand, stiffness, damping), pair)
    return all_within(others, pair.smaller_modulus)


def double_pole(hand: LoneHand, decay: Floats) -> tuple[Floats, Floats, Floats]:
    """Returns (K T²/m, B T/m, decay of the slower pole) where the pole exp(-decay) is double and one other pole is
    slower.

    There the map (K, B) -> (k, b) folds: two poles meet, and its Jacobian vanishes. Strongly damped hands reach it: the
    next pole of the loop passes the faster of their two real poles, and beyond it no spring and damper is equivalent. A
    double real pole belongs to a critically damped oscillator, so the curve is the paper's Figure 4 for that one.

    NaN if no other pole is slower, or several, or one that is not positive: then the dominant pair is not the one that
    folds.
    """
    oscillator = (2.0 * decay, decay**2)
    more = (2.0 * decay - hand.damping, decay**2 - hand.stiffness)
    kappa, beta, w = element_of_oscillator(hand, oscillator, more)
    if hand.degree < 3:
        return (np.full_like(decay, np.nan),) * 3
    others = roots(np.stack(without_pair(characteristic(hand, kappa, beta), w), axis=-1))
    slowest, modulus = others[..., 0], np.exp(-decay)
    next_one = np.abs(others[..., 1]) if others.shape[-1] > 1 else np.zeros_like(decay)
    leads = (decay < FASTEST) & (slowest.imag == 0.0) & (slowest.real > modulus) & (next_one < modulus)
    slow_decay = -np.log(np.where(leads, slowest.real, np.nan))
    return np.where(leads, kappa, np.nan), np.where(leads, beta, np.nan), slow_decay


SLOWEST = 1e-9  # radians per sample, the lowest frequency of the search
POINTS_PER_DECADE = 24  # of the slow frequencies
POINTS_PER_SAMPLE = 48  # of the others, for each sample of delay
BISECTIONS = 50  # from a tenth of a value to its last digit
IN_PHASE = 1e-9  # relative size of an out-of-phase part that counts as zero
ROUNDING = 1e-12  # relative width of an interval that counts as empty
GOLDEN = 0.5 * (np.sqrt(5.0) - 1.0)


class Undamped(NamedTuple):
    """Curve b = 0 at frequencies theta (G,); between two of them K T²/m and B T/m are monotonic."""

    theta: Floats
    kappa: Floats
    beta: Floats
    tied: list[tuple[float, float]]
    """Lines K T²/m + B T/m h + g = 0, as (h, g), whose whole length has its pole on the unit circle."""


def undamped_element(hand: LoneHand, theta: Floats) -> tuple[Floats, Floats]:
    """Element (K T²/m, B T/m) with which the hand oscillates without decay, at theta radians per sample."""
    return element_of_oscillator(hand, *undamped(hand, theta))[:2]


def undamped_curve(hand: LoneHand) -> Undamped:
    """Returns the whole curve, with its turning points among the frequencies."""
    late = hand.degree + 2
    slow = np.geomspace(SLOWEST, 0.05, 1 + POINTS_PER_DECADE * 8, endpoint=False)
    theta = np.concatenate([slow, np.linspace(0.05, np.pi, POINTS_PER_SAMPLE * late, endpoint=False)])
    along = undamped_element(hand, theta)
    turns = [_turning_points(hand, which, theta, along[which]) for which in (0, 1)]
    theta = np.unique(np.concatenate([theta, *turns]))
    return Undamped(theta, *undamped_element(hand, theta), _tied(hand, theta))


def stable_interval(
    hand: LoneHand, curve: Undamped, sought: int, given: Floats, is_stable: Callable[[Floats, Floats], Bools]
) -> tuple[Floats, Floats]:
    """Returns the lowest stable interval (least, most) of kappa (``sought`` 0) or beta (1), for values (n,) of the
    other. Stability does not change between two values at which a pole may cross the unit circle, so one test of each
    interval is enough. NaN if nothing is stable, infinity at an end without a limit."""
    with_real_pole = [at(hand, sought, given)[:, None] for at in (_with_pole_at_rest, _with_alternating_pole)]
    tied = [(-(g + h * given) if sought == 0 else -(g + given) / h)[:, None] for h, g in curve.tied]
    crossings = np.concatenate([*with_real_pole, *tied, _crossings(hand, curve, sought, given)], axis=-1)
    edges = np.sort(np.where(np.isfinite(crossings), crossings, np.inf), axis=-1)
    edges = np.concatenate([np.full((given.size, 1), -np.inf), edges, np.full((given.size, 1), np.inf)], axis=-1)
    inside = _between(edges[:, :-1], edges[:, 1:])
    given_there = np.broadcast_to(given[:, None], inside.shape)
    stable = is_stable(inside, given_there) if sought == 0 else is_stable(given_there, inside)
    wide = edges[:, 1:] > edges[:, :-1] + ROUNDING * np.abs(np.where(np.isfinite(edges[:, :-1]), edges[:, :-1], 0.0))
    stable &= wide
    place = np.arange(stable.shape[1])
    first = np.argmax(stable, axis=-1)[:, None]
    # A pole that only touches the circle leaves both sides stable: the interval extends to the next unstable one.
    broken = np.cumsum(wide & ~stable & (place > first), axis=-1) > 0
    last = np.max(np.where(stable & ~broken, place, 0), axis=-1)[:, None]
    least, most = (np.take_along_axis(edges, at, axis=-1)[:, 0] + 0.0 for at in (first, last + 1))
    any_stable = stable.any(axis=-1)
    return np.where(any_stable, least, np.nan), np.where(any_stable, most, np.nan)


def _between(low: Floats, high: Floats) -> Floats:
    """Returns the middle of each interval; beyond the last finite edge a far value in the range of floats."""
    scale = np.maximum(np.abs(np.where(np.isfinite(low), low, 0.0)), np.abs(np.where(np.isfinite(high), high, 0.0)))
    low = np.where(np.isfinite(low), low, -3.0 * scale - 1.0)
    high = np.where(np.isfinite(high), high, 3.0 * scale + 1.0)
    # Edges of very different size: the middle on a logarithmic scale, where the small stiffnesses are.
    both = (low > 0.0) & (high > 4.0 * low)
    return np.where(both, np.sqrt(np.where(both, low * high, 1.0)), 0.5 * (low + high))


def _with_pole_at_rest(hand: LoneHand, sought: int, given: Floats) -> Floats:
    """Value that puts a pole at z = 1: no stiffness holds the hand in place."""
    rest = PolePair(np.zeros(1), np.zeros(1))
    of_beta, of_device = (part.constant for part in relation_on_pair(hand, rest, (hand.p - rest.p, hand.q - rest.q)))
    if sought == 0:
        return np.asarray(-(of_device + of_beta * given))
    return np.asarray(-(given + of_device) / (of_beta if hand.damper.senses else np.nan))


def _with_alternating_pole(hand: LoneHand, sought: int, given: Floats) -> Floats:
    """Value that puts a pole at z = -1: the force alternates with every sample."""
    constant, *slopes = hand.polynomials @ (-1.0) ** np.arange(hand.degree, -1, -1)
    slopes[0] -= hand.lag * slopes[1]
    return np.asarray(-(constant + slopes[1 - sought] * given) / slopes[sought])


def _tied(hand: LoneHand, theta: Floats) -> list[tuple[float, float]]:
    """Lines (h, g) at frequencies where the damper's reading is in phase with the position and with the reaction of the
    mass, as with a centred damper at half the Nyquist frequency. There K and B have the same effect: the curve has a
    hole."""

    def slope(theta: Floats) -> Floats:
        return np.asarray(relation_of_oscillator(hand, *undamped(hand, theta))[0].slope) + 0.0 * theta

    sign = np.sign(slope(theta))
    at = np.flatnonzero(sign[1:] != sign[:-1])
    if not at.size:
        return []
    low, high = theta[at], theta[at + 1]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        before = np.sign(slope(middle)) == sign[at]
        low, high = np.where(before, middle, low), np.where(before, high, middle)
    h, g = relation_of_oscillator(hand, *undamped(hand, 0.5 * (low + high)))
    tied = np.abs(g.slope) <= IN_PHASE * np.abs(g.constant)
    return [(float(one), float(other)) for one, other in zip(h.constant[tied], g.constant[tied], strict=True)]


def _crossings(hand: LoneHand, curve: Undamped, sought: int, given: Floats) -> Floats:
    """Crossings of the curve with the given values, (n, crossings), padded with NaN."""
    along = curve.beta if sought == 0 else curve.kappa
    above = along[None, :] > given[:, None]
    row, piece = np.nonzero(above[:, 1:] != above[:, :-1])
    low, high = curve.theta[piece], curve.theta[piece + 1]
    low_above = above[row, piece]
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        is_above = undamped_element(hand, middle)[1 - sought] > given[row]
        low, high = np.where(is_above == low_above, middle, low), np.where(is_above == low_above, high, middle)
    element = undamped_element(hand, 0.5 * (low + high))
    # A sign change through infinity is no crossing.
    reached = np.abs(element[1 - sought] - given[row]) <= 1e-6 * (np.abs(given[row]) + np.abs(along[piece]))
    found = np.full((given.size, 1 + np.bincount(row, minlength=1).max()), np.nan)
    place = np.arange(row.size) - np.searchsorted(row, row)
    found[row, place] = np.where(reached, element[sought], np.nan)
    return found


def _turning_points(hand: LoneHand, which: int, theta: Floats, values: Floats) -> Floats:
    """Frequencies of the extremes of K or B along the curve, by golden section between the neighbours."""
    rises = np.diff(values) > 0.0
    at = 1 + np.flatnonzero(rises[1:] != rises[:-1])
    low, high = theta[at - 1], theta[at + 1]
    sign = np.where(rises[at - 1], 1.0, -1.0)
    for _ in range(BISECTIONS):
        one, other = high - GOLDEN * (high - low), low + GOLDEN * (high - low)
        there = sign * undamped_element(hand, np.stack([one, other]))[which]
        left = there[0] > there[1]
        low, high = np.where(left, low, one), np.where(left, other, high)
    return 0.5 * (low + high)
