"""The backward damper: the difference of the two newest positions (first-order Euler; Florens et al., §6)."""

from __future__ import annotations

from hapsim.theory.interface.shape import Damper


def backward(_cutoff: float) -> Damper:
    """v[n] = (y[n] - y[n-1])/T; v/y = w/(w + 1)."""
    return Damper(numerator=(1.0,), denominator=(1.0,), delays=1, of_positions=(1.0, -1.0), of_velocities=())
