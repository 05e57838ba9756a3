"""The damper is linear."""

from __future__ import annotations

from hapsim.theory.links.shape import Linear


def damper(damping: float) -> Linear:
    """A damper of so many N·s/m."""
    return Linear(0.0, damping)
