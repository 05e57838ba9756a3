"""The cell is linear: a mass, and a spring and a damper to what stays."""

from __future__ import annotations

from hapsim.theory.links.shape import Linear


def cell(stiffness: float, damping: float) -> Linear:
    """What holds the cell's mass to where it rests. N/m, N·s/m."""
    return Linear(stiffness, damping)
