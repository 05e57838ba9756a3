"""A force above its limit is cut to it, and the tick counted: the hand then meets less than the scene asks."""

from __future__ import annotations

from hapsim.compiled import inlined


@inlined
def cut(force, limit):
    """A force (N), or where it is larger its limit, to the same side."""
    return min(max(force, -limit), limit)
