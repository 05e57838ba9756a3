"""What the hand feels at one frequency: the force through the sampled loop, over the velocity (paper, Figure 2)."""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.interface import HOLDS, SAMPLINGS, DamperModel, Term


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
    numerator, denominator = (np.polyval(part[::-1], w) for part in (damper.numerator, damper.denominator))
    return np.asarray(w * numerator / denominator * np.exp(-1j * damper.delays * theta))


def _through(terms: tuple[Term, ...], theta: Floats) -> Complexes:
    """A transfer function at s = j theta."""
    s = 1j * theta
    return np.asarray(sum(weight * np.exp(-lag * s) / s**integrations for weight, lag, integrations in terms))
