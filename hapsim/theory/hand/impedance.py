"""What the hand meets at one frequency: the force through the sampled loop, over the velocity (paper, Figure 2)."""

from __future__ import annotations

import numpy as np

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.interface import HOLDS, SAMPLINGS
from hapsim.theory.interface.shape import Damper, Term


def late_and_held(theta: Floats, delay: float, hold: str, sampling: str) -> Complexes:
    """What delay, hold and sampling make of a force that swings with theta radians per sample: its fundamental."""
    through = _through(HOLDS[hold].terms, theta) * _through(SAMPLINGS[sampling].terms, theta)
    return np.asarray(through * np.exp(-1j * delay * theta))


def damper_gain(damper: Damper, theta: Floats) -> Complexes:
    """The damper's velocity over the true one at theta: 1 where it is what it should be."""
    if damper.senses:
        return np.ones_like(theta, dtype=complex)
    w = np.expm1(1j * theta)
    numerator, denominator = (np.polyval(part[::-1], w) for part in (damper.numerator, damper.denominator))
    # w/(j theta), without 0/0.
    straight = np.sinc(0.5 * theta / np.pi) * np.exp(0.5j * theta)
    return np.asarray(straight * numerator / denominator * np.exp(-1j * damper.delays * theta))


def _through(terms: tuple[Term, ...], theta: Floats) -> Complexes:
    """A transfer function at s = j theta."""
    s = 1j * theta
    return np.asarray(sum(weight * np.exp(-lag * s) / s**integrations for weight, lag, integrations in terms))
