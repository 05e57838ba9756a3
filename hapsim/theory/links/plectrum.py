"""The plectrum: two linear systems, the one that grips and the one that let go, and the change between them.

Gripping it is a spring and a damper; let go it is nothing. Letting go loses what the spring held, K release²/2. It
grips again where its ends have passed each other by no more than they move in a sample, v T, which adds K (v T)²/2 at
the most: the only energy that the change itself brings in.
"""

from __future__ import annotations

from hapsim.theory.links.shape import Linear


def plectrum(stiffness: float, damping: float) -> Linear:
    """The link while it grips. N/m, N·s/m."""
    return Linear(stiffness, damping, "is taken as gripping all the time; let go, nothing is felt of it")
