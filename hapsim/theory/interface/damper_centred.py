"""The centred damper: the difference across two sample periods, which is the velocity at the sample before."""

from __future__ import annotations

from hapsim.theory.interface.shape import Damper


def centred(_cutoff: float) -> Damper:
    """v[n] = (y[n] - y[n-2])/(2 T); v/y = w (1 + w/2)/(1 + w)²."""
    return Damper(numerator=(1.0, 0.5), denominator=(1.0,), delays=2, of_positions=(0.5, 0.0, -0.5), of_velocities=())
