"""Where the map (K, B) -> (k, b) folds: two poles meet.

Its Jacobian vanishes where a pole of the pair meets a further one, for then the characteristic polynomial and its
derivative vanish together. Strongly damped hands reach it: the faster of their two real poles is passed by the next
one of the loop, and beyond it no spring and damper is equivalent. A double real pole exp(-decay T) belongs to a
critically damped oscillator, so the curve is the paper's Figure 4 for that oscillator, as far as a slower pole leads.
"""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.hand.inverse_map import element_of_oscillator
from hapsim.theory.hand.loop_equation import LoopEquation, characteristic
from hapsim.theory.hand.poles import roots, without_pair

FASTEST = 10.0  # decay in a sample period, above which the double pole is lost in the rounding of the others


def double_pole(equation: LoopEquation, decay: Floats) -> tuple[Floats, Floats, Floats]:
    """(K T²/m, B T/m, decay of the slower pole) where the pole exp(-decay) is double and one further pole is slower.

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
