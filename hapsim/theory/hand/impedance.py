"""What the hand feels at one frequency: the force through the sampled loop, over the velocity (paper, Figure 2)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hapsim.holds import HOLDS, Term
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.interface import SAMPLINGS, DamperModel, damper_answer


def late_and_held(theta: Floats, delay: float, hold: str, sampling: str) -> Complexes:
    """What delay, hold and sampling make of a force that swings with theta radians per sample: its fundamental."""
    through = _through(HOLDS[hold].terms, theta) * _through(SAMPLINGS[sampling].terms, theta)
    return np.asarray(through * np.exp(-1j * delay * theta))


def damper_gain(damper: DamperModel, theta: Floats) -> Complexes:
    """The damper's velocity over the true one at theta: 1 where it is what it should be."""
    if damper.senses:
        return np.ones_like(theta, dtype=complex)
    return np.asarray(velocity_read(damper, theta) / (1j * theta))


def velocity_read(damper: DamperModel, theta: Floats) -> Complexes:
    """What the damper makes of positions, in metres per sample, over the position, at z = exp(j theta)."""
    w = 2j * np.sin(0.5 * theta) * np.exp(0.5j * theta)  # z - 1, to all its digits
    return damper_answer(damper, np.exp(1j * theta), w)


def _through(terms: tuple[Term, ...], theta: Floats) -> Complexes:
    """A transfer function at s = j theta, theta not 0.

    All that the terms have of 1/s, 1/s², … cancels between them. So each is taken without it: exp(-lag s)/s^p less the
    first p powers is (-lag)^p times the remainder of the exponential series, which has all its digits at small theta.
    """
    through = np.zeros(theta.shape, complex)
    for weight, lag, power in terms:
        through += weight * (-lag) ** power * _remainder(power, -1j * lag * theta)
    return through


def _remainder(power: int, z: Any) -> Complexes:
    """sum of z^k / (k + power)!: the exponential series of z from z^power on, divided by it."""
    near, series = np.where(np.abs(z) < 1.0, z, 0.0), np.zeros_like(z)
    for k in reversed(range(20)):
        series = series * near + 1.0 / math.factorial(k + power)
    far, found = np.where(np.abs(z) < 1.0, 1.0, z), np.exp(z)
    for k in range(power):
        found = (found - 1.0 / math.factorial(k)) / far
    return np.where(np.abs(z) < 1.0, series, found)
