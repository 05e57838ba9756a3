"""The spring is linear."""

from __future__ import annotations

from hapsim.theory.links.shape import Linear


def spring(stiffness: float) -> Linear:
    """A spring of so many N/m."""
    return Linear(stiffness, 0.0)
