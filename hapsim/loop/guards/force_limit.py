"""A force above its limit is cut to it, and the tick counted: the hand then feels less than the scene asks."""

from __future__ import annotations

from hapsim.compiling import inlined


@inlined
def cut(force, limit):
    """A force (N), or where it is larger its limit, to the same side. What is no number comes out as none, or as the
    limit."""
    return -limit if force < -limit else limit if force > limit else force
