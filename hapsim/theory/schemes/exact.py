"""The exact solution: exp(A T), with A the rates of change."""

from __future__ import annotations

from hapsim.theory.arrays import Floats
from hapsim.theory.schemes.scheme import Scheme, always_stable, rates


def _step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
    from scipy.linalg import expm

    step: Floats = expm(period * rates(mass, stiffness, damping))
    return step


EXACT = Scheme(_step, always_stable, order=0, error=0.0)
