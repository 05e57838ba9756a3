"""A force that is not a number never leaves: the loop stops instead."""

from __future__ import annotations

import math

from hapsim.compiling import inlined


@inlined
def is_finite(force):
    """Whether a force is a number."""
    return math.isfinite(force)
