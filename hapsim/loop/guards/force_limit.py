"""A force that is not a number never leaves: the loop stops. One above its limit is clipped and the tick is counted:
the hand then feels less than the scene asks."""

from __future__ import annotations

import math

from hapsim.compiling import inlined


@inlined
def is_finite(force):
    """Whether a force is a number."""
    return math.isfinite(force)


@inlined
def clip(force, limit):
    """A force in N, clipped to -limit ... limit. What is no number comes out as none, or as the limit."""
    return -limit if force < -limit else limit if force > limit else force
