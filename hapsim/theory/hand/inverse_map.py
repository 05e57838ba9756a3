"""The simulated element that the hand feels as a given oscillator: the paper's Figure 4, in closed form.

In normalised units, periods as time: sigma and kappa of s² + sigma s + kappa are asked for, K T²/m and B T/m answer.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Bools, Floats
from hapsim.theory.hand.loop_equation import LoopEquation, characteristic, element_on_pair
from hapsim.theory.hand.pole_pair import LinearOnPair, PolePair, change_of_quadratic, pair_of_oscillator
from hapsim.theory.hand.poles import all_within, roots, without_pair

FASTEST = 10.0  # decay in a sample period, above which the double pole is lost in the rounding of the others


def element_of_oscillator(
    equation: LoopEquation, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]
) -> tuple[Floats, Floats, PolePair]:
    """(K T²/m, B T/m, the pair of poles). Neither finite where the element cannot tell the two poles apart.

    ``oscillator``: (sigma, kappa). ``more``: the same without the device's own friction and spring; apart, because
    the small part that the element has to add would be lost in their sum.
    """
    velocity, ratio, (p_change, q_change) = _parts(equation, oscillator, more)
    (H, H_slope, pair), (r, r_slope, _) = velocity, ratio
    p, q = pair
    # K + B w H + (p_change w + q_change) r = 0 modulo the pair's quadratic; K is multiplied out to products, because
    # for a slow motion the sum of its parts would cancel.
    steepness = H - H_slope * p
    by_p = q * (r_slope * H - r * H_slope)
    by_q = r * steepness + r_slope * H_slope * q
    stiffness = (p_change * by_p - q_change * by_q) / steepness
    damping = -(p_change * (r - r_slope * p) + q_change * r_slope) / steepness
    if equation.damper.senses:
        stiffness = stiffness - equation.plant.offset * damping
    return stiffness, damping + equation.lag * stiffness, pair


def _parts(
    equation: LoopEquation, oscillator: tuple[Floats, Floats], more: tuple[Floats, Floats]
) -> tuple[LinearOnPair, LinearOnPair, tuple[Floats, Floats]]:
    """(H, r, change) on the oscillator's poles, where the equation is K + B w H + (change[0] w + change[1]) r = 0.

    The free mass's factor is that line there: the oscillator's own vanishes.
    """
    pair = pair_of_oscillator(*oscillator)
    plant = equation.plant
    change = change_of_quadratic(pair, oscillator, more, plant.damping, plant.stiffness)
    return *element_on_pair(equation, pair.w), change


def undamped_parts(equation: LoopEquation, theta: Floats) -> tuple[LinearOnPair, LinearOnPair]:
    """(h, g) with K T²/m + B T/m h + g = 0 where a pole swings undamped at theta radians per sample.

    As lines over that pole and its conjugate: where both slopes vanish, K and B are tied by this one equation only.
    """
    velocity, ratio, (p_change, q_change) = _parts(equation, *undamped(equation, theta))
    w = velocity.pair.w
    moving = w.times(velocity)
    if equation.damper.senses:
        moving = moving.plus(equation.plant.offset)
    return moving, w.scaled(p_change).plus(q_change).times(ratio)


def undamped(equation: LoopEquation, theta: Floats) -> tuple[tuple[Floats, Floats], tuple[Floats, Floats]]:
    """``oscillator`` and ``more`` of a swing of theta radians per sample that neither grows nor dies away."""
    zero, plant = np.zeros_like(theta), equation.plant
    return (zero, theta**2), (zero - plant.damping, theta**2 - plant.stiffness)


def is_attainable(sigma: Floats | float, kappa: Floats | float) -> Bools:
    """Whether the oscillator swings below the Nyquist frequency."""
    with np.errstate(over="ignore"):
        return np.asarray(kappa - 0.25 * np.square(sigma) < np.pi**2)


def leads(equation: LoopEquation, stiffness: Floats, damping: Floats, pair: PolePair) -> Bools:
    """Whether every further pole of the loop decays faster than both of the pair."""
    others = without_pair(characteristic(equation, stiffness, damping), pair)
    return all_within(others, pair.smaller_modulus)


def double_pole(equation: LoopEquation, decay: Floats) -> tuple[Floats, Floats, Floats]:
    """(K T²/m, B T/m, decay of the slower pole) where the pole exp(-decay) is double and one further pole is slower.

    There the map (K, B) -> (k, b) folds: two poles meet, and its Jacobian vanishes. Strongly damped hands reach it: the
    next pole of the loop passes the faster of their two real poles, and beyond it no spring and damper is equivalent. A
    double real pole belongs to a critically damped oscillator, so the curve is the paper's Figure 4 for that one.

    NaN where none is, or more than one, or where it is not positive: then the dominant pair is not the one that folds.
    """
    plant = equation.plant
    oscillator = (2.0 * decay, decay**2)
    more = (2.0 * decay - plant.damping, decay**2 - plant.stiffness)
    kappa, beta, w = element_of_oscillator(equation, oscillator, more)
    if equation.degree < 3:
        return (np.full_like(decay, np.nan),) * 3
    others = roots(np.stack(without_pair(characteristic(equation, kappa, beta), w), axis=-1))
    slowest, modulus = others[..., 0], np.exp(-decay)
    next_one = np.abs(others[..., 1]) if others.shape[-1] > 1 else np.zeros_like(decay)
    leads = (decay < FASTEST) & (slowest.imag == 0.0) & (slowest.real > modulus) & (next_one < modulus)
    slow_decay = -np.log(np.where(leads, slowest.real, np.nan))
    return np.where(leads, kappa, np.nan), np.where(leads, beta, np.nan), slow_decay
