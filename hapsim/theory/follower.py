"""Admittance: the step of a simulated mass that a sensed force moves, while the device follows its position.

The mass M, with a damping B, moves once a sample, by the sensed force f and the force F that the scene computes:

    M (X[n+1] - 2 X[n] + X[n-1])/T² = f[n] + F[n] - B (X[n] - X[n-1])/T

The device goes after X, and the hand on it is a spring, a damper and a mass:

    f[n] = -kh x[n] - bh v[n] - mh (x[n] - 2 x[n-1] + x[n-2])/T²

A device that follows exactly is at X[n-d] at sample n, in a straight line from sample to sample, and v is the slope of
the line that ends there. A servo is x'' + 2 ζ ω x' + ω² x = ω² u; its command u is X[n+1], computed at sample n, from
(n + d) T on. This is all that differs from a real mass behind a hold: another ``DeviceStep``, whose inner states are
the way of the device behind the mass, its velocity, and the last steps of both.

Lengths in metres, times in sample periods, forces as T²/M f. Positions count from X, so slow motions keep their digits.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.theory.device_step import DeviceStep, ages_of, through
from hapsim.theory.interface import hold_segments, whole_and_fraction

_OF_SERVO = 4  # inner states


class Follower(NamedTuple):
    """Device that goes after a simulated mass, and the part of the hand on it that a network's channel does not have.

    Attributes:
        hand_damping: bh, N·s/m; the channel's friction is B + bh, and its own spring is kh.
        hand_mass: mh, beyond the force sensor, kg.
        frequency: ω of its servo, rad/s; 0: it follows exactly.
        ratio: ζ of its servo.
    """

    hand_damping: float = 0.0
    hand_mass: float = 0.0
    frequency: float = 0.0
    ratio: float = 1.0

    def normalised(self, mass: float, rate: float) -> Follower:
        """Returns it in the units of a step: bh T/M, mh/M and ω T."""
        return Follower(self.hand_damping / (mass * rate), self.hand_mass / mass, self.frequency / rate, self.ratio)

    def inner(self, delay: float) -> int:
        """Number of inner states."""
        steps = whole_and_fraction(delay)[0] + 2
        return steps + _OF_SERVO if self.frequency else steps


@lru_cache(maxsize=64)
def follower_step(damping: float, stiffness: float, delay: float, follower: Follower) -> DeviceStep:
    """Returns the step of a simulated mass with normalised friction (B + bh) T/M and own spring kh T²/M, and of the
    device after it. The inner states are the mass's last steps X[n-1] - X[n-2], ...; with a servo before them the way
    x - X, the velocity, and the last two steps of the device."""
    bh, mh, frequency, ratio = follower
    whole, fraction = whole_and_fraction(delay)
    size = 2 + follower.inner(delay)
    x, last, *inner, force = np.eye(size + 1)
    steps = [last, *inner[_OF_SERVO if frequency else 0 :]]
    if frequency:
        way, v, step, before = inner[:_OF_SERVO]
    else:
        way = -sum(steps[:whole], fraction * steps[whole])
        v = steps[whole]
        step, before = ((1.0 - fraction) * steps[at] + fraction * steps[at + 1] for at in (whole, whole + 1))
    faster = force - stiffness * (x + way) - bh * v - mh * (step - before) - (damping - bh) * last
    moved = last + faster
    rows = [moved, faster, 0.0 * x, last + faster]
    if frequency:
        commands = [moved, 0.0 * x, *-np.cumsum(steps, axis=0)][whole:]  # X[n+1], X[n], X[n-1], ... beyond X[n]
        segments = hold_segments("zoh", fraction)
        gone, accelerated = (
            of[0] * way + of[1] * v + frequency**2 * sum(map(np.multiply, by, commands), 0.0 * x)
            for of, by in zip(*through(segments, 2.0 * ratio * frequency, frequency**2, ages_of(segments)), strict=True)
        )
        rows += [gone - moved, accelerated, gone - step, step - before]
    rows += [new - old for new, old in pairwise(steps)]
    whole_step = np.array(rows)
    whole_step.flags.writeable = False
    return DeviceStep(whole_step[:, :size], whole_step[:, size:])
