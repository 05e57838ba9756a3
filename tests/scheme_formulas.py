"""Formulas of each scheme for M x'' + B x' + K x = 0, against which tests compare the theory and the kernel."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq


def step_matrix(scheme: str, mass: np.ndarray, K: np.ndarray, B: np.ndarray, period: float) -> np.ndarray:
    """(2 n, 2 n): (x, v) from sample to sample; kg, N/m, N·s/m, s."""
    one, zero = np.eye(mass.size), np.zeros((mass.size, mass.size))
    pull = np.hstack([-K, -B]) / mass[:, None]
    if scheme in ("cordis", "semi_implicit"):
        v = np.hstack([zero, one]) + period * pull
        return np.vstack([np.hstack([one, zero]) + period * v, v])
    z, unit = period * np.vstack([np.hstack([zero, one]), pull]), np.eye(2 * mass.size)
    if scheme == "midpoint":
        return np.linalg.solve(unit - z / 2, unit + z / 2)
    if scheme == "rk4":
        return sum((np.linalg.matrix_power(z, i) / math.factorial(i) for i in range(1, 5)), unit)
    assert scheme == "exact"
    return np.asarray(expm(z))


def spectral_radius(step: np.ndarray) -> float:
    """The largest modulus of an eigenvalue."""
    return float(np.abs(np.linalg.eigvals(step)).max())


def stiffness_limit(scheme: str, mass: float, damping: float, period: float) -> float:
    """The stiffness in N/m up to which one oscillator (kg, N·s/m) is stable; infinity where it always is."""
    unit, b = mass / period**2, damping * period / mass
    if scheme in ("midpoint", "exact"):
        return math.inf
    if scheme != "rk4":
        return max(0.0, 4.0 - 2.0 * b) * unit

    def beyond(k: float) -> float:
        return spectral_radius(step_matrix("rk4", np.ones(1), np.array([[k]]), np.array([[b]]), 1.0)) - 1.0

    return float(brentq(beyond, max(0.25 * b * b, 1e-3), 20.0, xtol=1e-14)) * unit
