"""What is known of a scheme."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats


class SchemeModel(NamedTuple):
    """A scheme.

    Attributes:
        step: (n,) masses in kg, (n, n) K in N/m, (n, n) B in N·s/m, T in s -> the matrix (2 n, 2 n) that takes (x, v)
            from sample to sample.
        stiffness_limit: m in kg, B in N·s/m, T in s -> N/m, the stiffness of a single oscillator up to which it is
            stable; infinity where it always is, 0 where it is at none.
        order: p, and error: c, of the frequency that a weakly damped oscillator has: omega (1 + c (omega T)^p) for
            small omega T. 0 both where it is the true one.
        advance: what becomes in a sample of any z whose rates of change are A z: (N, N) T A, (N, n) of several z ->
            (N, n); None of a scheme that is made for masses alone.
    """

    step: Callable[[Floats, Floats, Floats, float], Floats]
    stiffness_limit: Callable[[float, float, float], float]
    order: int
    error: float
    advance: Callable[[Any, Any], Any] | None = None


def spectral_radius(step: Floats) -> float:
    """The largest modulus of an eigenvalue: how fast the slowest motion to decay goes, a sample."""
    return float(np.abs(np.linalg.eigvals(step)).max(initial=0.0))


def rates(mass: Floats, stiffness: Floats, damping: Floats) -> Floats:
    """(2 n, 2 n): what makes the rates of change of (x, v) out of it."""
    n = mass.size
    zero, one = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, one], [-stiffness / mass[:, None], -damping / mass[:, None]]])


def step_by(advance: Callable[[Any, Any], Any]) -> Callable[[Floats, Floats, Floats, float], Floats]:
    """The ``step`` of a scheme that advances anything."""

    def step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
        return np.asarray(advance(period * rates(mass, stiffness, damping), np.eye(2 * mass.size)), float)

    return step


def always_stable(_mass: float, _damping: float, _period: float) -> float:
    """The limit of a scheme that has none."""
    return float("inf")
