"""A force that is not a number never leaves: the loop stops instead. One above its limit is cut to it, and the tick
counted: the hand then feels less than the scene asks."""

from __future__ import annotations

import math

from hapsim.compiling import inlined


@inlined
def is_finite(force):
    """Whether a force is a number."""
    return math.isfinite(force)


@inlined
def cut(force, limit):
    """A force (N), or where it is larger its limit, to the same side. What is no number comes out as none, or as the
    limit."""
    return -limit if force < -limit else limit if force > limit else force
