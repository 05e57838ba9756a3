"""Recordings as instruments write them, of known branches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

X = np.array([0.0, 0.6, 1.2, 1.6, 2.4, 3.0])  # mm
PRESS = np.array([0.0, 55.0, 70.0, 45.0, 60.0, 110.0])  # gf
RELEASE = np.array([0.0, 35.0, 45.0, 30.0, 42.0, 110.0])


def press_at(mm: Floats) -> Floats:
    return np.interp(mm, X, PRESS)


def release_at(mm: Floats) -> Floats:
    return np.interp(mm, X, RELEASE)


def stroke(top: float = 3.0, noise: float = 0.0, seed: int = 0, step: float = 0.005) -> tuple[Floats, Floats]:
    """Distances in steps of 5 µm, each twice, and forces to 0.1 gf: down, a rest at the bottom, and up again."""
    way = np.repeat(np.arange(0.0, top + 0.5 * step, step), 2)
    mm = np.concatenate((np.zeros(20), way, np.full(50, way[-1]), way[::-1]))
    half = 20 + way.size + 25
    force = np.concatenate((press_at(mm[:half]), release_at(mm[half:])))
    force += np.random.default_rng(seed).normal(0.0, noise, mm.size)
    return np.round(mm, 3), np.round(force, 1)


def strokes(number: int, noise: float = 0.0) -> tuple[Floats, Floats]:
    """Several strokes, the second of which is not finished."""
    each = [stroke(1.0 if i == 1 else 3.0, noise, seed=i) for i in range(number)]
    return np.concatenate([mm for mm, _ in each]), np.concatenate([force for _, force in each])


def text_of(mm: Floats, force: Floats, head: str = "mm,gf") -> str:
    """Returns the rows of a file with two columns."""
    return "\n".join([head, *(f"{x:g},{y:g}" for x, y in zip(mm, force, strict=True))]) + "\n"
