"""Where the loop is stable: the stable interval of one of K and B (Florens et al., §6.2).

Its ends are the values at which a pole stands on the unit circle: on the curve b = 0, where the hand feels an
oscillator without damping, at z = -1, or at z = 1, where nothing is left of what holds the hand in its place.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.hand.lone_hand import LoneHand, relation_on_pair
from hapsim.theory.hand.pole_pair import PolePair
from hapsim.theory.network.crossings import Crossings

ROUNDING = 1e-12  # an interval relatively narrower than this is none

IsStable = Callable[[Floats, Floats], Bools]


def stable_interval(hand: LoneHand, sought: int, given: Floats, is_stable: IsStable) -> tuple[Floats, Floats]:
    """The lowest stable interval of kappa (``sought`` 0) or beta (1), for given values (n,) of the other.

    Between two values at which a pole may cross the unit circle stability does not change: one test of each interval
    is enough. Returns (least, most), NaN where nothing is stable, infinity where nothing ends it.
    """
    edges = np.full((given.size, 1), np.inf)
    if (finite := np.isfinite(given)).any():
        found = _crossings(hand, sought, given[finite])
        edges = np.full((given.size, found.shape[1]), np.inf)
        edges[finite] = np.sort(np.where(np.isfinite(found), found, np.inf), axis=-1)
    edges = np.concatenate([np.full((given.size, 1), -np.inf), edges, np.full((given.size, 1), np.inf)], axis=-1)
    inside = _between(edges[:, :-1], edges[:, 1:])
    given_there = np.broadcast_to(given[:, None], inside.shape)
    stable = is_stable(inside, given_there) if sought == 0 else is_stable(given_there, inside)
    wide = edges[:, 1:] > edges[:, :-1] + ROUNDING * np.abs(np.where(np.isfinite(edges[:, :-1]), edges[:, :-1], 0.0))
    stable &= wide
    place = np.arange(stable.shape[1])
    first = np.argmax(stable, axis=-1)[:, None]
    # Where a pole only touches the circle both sides are stable: the interval goes on to the next unstable one.
    broken = np.cumsum(wide & ~stable & (place > first), axis=-1) > 0
    last = np.max(np.where(stable & ~broken, place, 0), axis=-1)[:, None]
    least, most = (np.take_along_axis(edges, at, axis=-1)[:, 0] + 0.0 for at in (first, last + 1))
    any_stable = stable.any(axis=-1)
    return np.where(any_stable, least, np.nan), np.where(any_stable, most, np.nan)


def _crossings(hand: LoneHand, sought: int, given: Floats) -> Floats:
    """(n, crossings): every value of what is sought at which a pole stands on the circle, 0 (there one may stand as it
    is), and NaN."""
    of_element = np.stack([hand.reads[0] - hand.lag * hand.reads[1], hand.reads[1]])
    change = hand.change - given[:, None, None] * np.outer(hand.push, of_element[1 - sought])
    found = Crossings(change).factors(hand.push, -of_element[sought])
    found[:, -2] = _with_pole_at_rest(hand, sought, given)
    return np.column_stack([found, np.zeros(given.size)])


def _with_pole_at_rest(hand: LoneHand, sought: int, given: Floats) -> Floats:
    """The value that puts a pole at z = 1, in closed form; of a hand without a spring it is 0."""
    rest = PolePair(np.zeros(1), np.zeros(1))
    of_beta, of_device = (part.constant for part in relation_on_pair(hand, rest, (hand.p - rest.p, hand.q - rest.q)))
    if sought == 0:
        return np.asarray(-(of_device + of_beta * given))
    return np.asarray(-(given + of_device) / (of_beta if hand.damper.senses else np.nan))


def _between(low: Floats, high: Floats) -> Floats:
    """A value inside each interval, halfway; beyond the last finite edge far out, but not beyond all numbers."""
    scale = np.maximum(np.abs(np.where(np.isfinite(low), low, 0.0)), np.abs(np.where(np.isfinite(high), high, 0.0)))
    low = np.where(np.isfinite(low), low, -3.0 * scale - 1.0)
    high = np.where(np.isfinite(high), high, 3.0 * scale + 1.0)
    # Edges far apart in size: halfway on a logarithmic scale, where the small stiffnesses are.
    both = (low > 0.0) & (high > 4.0 * low)
    return np.where(both, np.sqrt(np.where(both, low * high, 1.0)), 0.5 * (low + high))
