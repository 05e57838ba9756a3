"""The simulated element that the hand feels as a given oscillator: the paper's Figure 4, in closed form.

In normalised units, periods as time: sigma and kappa of s² + sigma s + kappa are asked for, K T²/m and B T/m answer.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.hand.lone_hand import LoneHand, Relation, characteristic, element_of_relation, relation_on_pair
from hapsim.theory.hand.pole_pair import PolePair, change_of_quadratic, pair_of_oscillator
from hapsim.theory.hand.poles import all_within, roots, without_pair

FASTEST = 10.0  # decay in a sample period, above which the double pole is lost in the rounding of the others


def element_of_oscillator(
    hand: LoneHand, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]
) -> tuple[Floats, Floats, PolePair]:
    """(K T²/m, B T/m, the pair of poles). Neither finite where the element cannot tell the two poles apart.

    ``oscillator``: (sigma, kappa). ``more``: the same without the device's own friction and spring; apart, because
    the small part that the element has to add would be lost in their sum.
    """
    relation = relation_of_oscillator(hand, oscillator, more)
    return *element_of_relation(hand, relation), relation[0].pair


def relation_of_oscillator(hand: LoneHand, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]) -> Relation:
    """``relation_on_pair`` of the oscillator's poles."""
    pair = pair_of_oscillator(*oscillator)
    return relation_on_pair(hand, pair, change_of_quadratic(pair, oscillator, more, hand.damping, hand.stiffness))


def undamped(hand: LoneHand, theta: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """``oscillator`` and ``more`` of a swing of theta radians per sample that neither grows nor dies away."""
    zero = np.zeros_like(theta)
    return (zero, theta**2), (zero - hand.damping, theta**2 - hand.stiffness)


def is_attainable(sigma: Floats | float, kappa: Floats | float) -> Bools:
    """Whether the oscillator swings below the Nyquist frequency."""
    with np.errstate(over="ignore"):
        return np.asarray(kappa - 0.25 * np.square(sigma) < np.pi**2)


def leads(hand: LoneHand, stiffness: Floats, damping: Floats, pair: PolePair) -> Bools:
    """Whether every further pole of the loop decays faster than both of the pair."""
    others = without_pair(characteristic(hand, stiffness, damping), pair)
    return all_within(others, pair.smaller_modulus)


def double_pole(hand: LoneHand, decay: Floats) -> tuple[Floats, Floats, Floats]:
    """(K T²/m, B T/m, decay of the slower pole) where the pole exp(-decay) is double and one further pole is slower.

    There the map (K, B) -> (k, b) folds: two poles meet, and its Jacobian vanishes. Strongly damped hands reach it: the
    next pole of the loop passes the faster of their two real poles, and beyond it no spring and damper is equivalent. A
    double real pole belongs to a critically damped oscillator, so the curve is the paper's Figure 4 for that one.

    NaN where none is, or more than one, or where it is not positive: then the dominant pair is not the one that folds.
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
