"""How a device's moving part answers to the forces that it was sent: the model that `device_fit` fits.

    m x'' + b0 x' + k0 x = F(t) + F0 - Fc sign(x') - k (x - y) - c (x' - y'),    M y'' = k (x - y) + c (x' - y')

The second mass M at y, on a spring and a damper, is a hand that does not hold the first one firmly. In sample periods
and forces per mass, with A = b0 T/m, W = k0 T²/m and the delay D + phi, force n acts from n + D + phi on, as the
device's hold says. Between two changes of the force the motion is the exponential of the equation's matrix; over
samples it is a recurrence, so that a whole record is one linear filter. Where the velocity keeps its sign dry friction
is a constant force, and the motion is linear in all but A, W and delay.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter

from hapsim.holds import HOLDS
from hapsim.measuring.converters import Converters, Floats


class SampledMotion(NamedTuple):
    """One sample of the motion, and what is measured at its end, in sample periods:

    state[n + 1] = step state[n] + sum over ages of gains[age] f[n - D - age], and
    y[n + 1] = row state[n] + sum over ages of gains[age][seen] f[n - D - age],

    the state being position and velocity of each mass, f force per mass. Behind the state each gain has the part of the
    position's mean; `steady` is the gain of a constant force, `polynomial` that of `step`.
    """

    whole_delay: int
    step: Floats
    row: Floats
    seen: int
    gains: tuple[Floats, ...]
    steady: Floats
    polynomial: Floats

    def answer_to(self, forces: Sequence[Floats]) -> Floats:
        """Positions along the last axis, the first one sample after rest at 0, under f[n - D - age] for each age."""
        return np.asarray(sum(self._acting(force, gain) for force, gain in zip(forces, self.gains, strict=True)))

    def answer_at_once(self, force: Floats) -> Floats:
        """Positions along the last axis under forces that each act for one sample, the first one sample after rest."""
        return self._acting(force, self.steady)

    def free(self, samples: int) -> Floats:
        """(samples, states) positions without a force, from each unit state on, the first one sample after it."""
        start = np.eye(1, samples)[0]
        return np.column_stack([self._filtered(start, unit, 0.0, ahead=1) for unit in np.eye(self.row.size)])

    def _acting(self, force: Floats, gain: Floats) -> Floats:
        return self._filtered(force, gain, float(gain[self.seen]))

    def _filtered(self, force: Floats, gain: Floats, seen: float, ahead: int = 0) -> Floats:
        """y[n + 1] = [row (zI - step)^-1 gain + seen] force[n], as one filter; `ahead`: samples sooner."""
        markov, state = [seen], gain[: self.row.size]
        for _ in range(self.row.size):
            markov.append(float(self.row @ state))
            state = self.step @ state
        numerator = np.convolve(self.polynomial, markov)[: self.polynomial.size]
        return np.asarray(lfilter(numerator[ahead:], self.polynomial, force))


def sampled_motion(
    friction: float, stiffness: float, delay: float, converters: Converters, hand: Sequence[float] = ()
) -> SampledMotion:
    """`friction` = b0 T/m, `stiffness` = k0 T²/m, `delay` in sample periods; any sign, for a fit tries any. `hand`:
    k T²/m, c T/m and m/M of a second mass, where there is one."""
    whole = math.floor(delay)
    part = delay - whole
    states = 4 if hand else 2
    state, force, area, slope = slice(states), states, states + 1, states + 2
    matrix = np.zeros((states + 3, states + 3))
    matrix[0, 1] = matrix[1, force] = matrix[area, 0] = matrix[force, slope] = 1.0
    matrix[1, :2] = -stiffness, -friction
    if hand:
        spring, damper, ratio = hand
        pull = np.array([spring, damper, -spring, -damper])
        matrix[1, state] -= pull
        matrix[2, 3], matrix[3, state] = 1.0, ratio * pull
    through = expm(matrix)
    pieces = [piece for piece in HOLDS[converters.hold].pieces(part) if piece.duration > 0.0]
    gains = np.zeros((states + 3, max(len(weights) for _, *each in pieces for weights in each)))
    for duration, impulse, level, grows in pieces:
        gains[1, : len(impulse)] += impulse
        gains[[force, slope]] = 0.0
        gains[force, : len(level)], gains[slope, : len(grows)] = level, grows
        gains = expm(matrix * duration) @ gains
    seen = area if converters.averages else 0
    step, row = through[state, state], through[seen, state]
    return SampledMotion(whole, step, row, seen, tuple(gains.T), through[:, force], np.asarray(np.poly(step)))
