"""A force that is not a number never leaves: the loop stops instead."""

from __future__ import annotations

import math

from hapsim.compiled import inlined


@inlined
def all_finite(force):
    """Whether every channel's force is a number."""
    for f in force:  # noqa: SIM110  compiled: a plain loop
        if not math.isfinite(f):
            return False
    return True
