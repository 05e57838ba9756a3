"""A force above its limit is cut to it, and the tick counted: the hand then meets less than the scene asks."""

from __future__ import annotations

from hapsim.compiled import inlined


@inlined
def cut(force, limit):
    """Cuts each channel's force (N) to its limit; whether any was cut."""
    any_cut = False
    for c in range(force.size):
        if abs(force[c]) > limit[c]:
            force[c] = limit[c] if force[c] > 0.0 else -limit[c]
            any_cut = True
    return any_cut
