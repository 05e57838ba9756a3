"""The sensed damper: the velocity that the device itself measures, late and held like the position, but no difference.

With averaged sampling it is the mean velocity over the sample period that has just ended.
"""

from __future__ import annotations

from hapsim.theory.interface.shape import Damper


def sensed(_cutoff: float) -> Damper:
    """v[n] is read from the plant: a second output, not a filter of the first.

    At an end that is not the device's there is nothing to sense: a simulated point's velocity is the backward
    difference of its positions, which the filter below says.
    """
    return Damper(
        numerator=(1.0,), denominator=(1.0,), delays=1, of_positions=(1.0, -1.0), of_velocities=(), senses=True
    )
