"""Stretches of a record without a gap, in which what acted on the device is known."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.recording.trace import Trace

_ALWAYS = 0.99  # of all samples: what is late so often is late by the wire's nature


def unbroken(trace: Trace, spoilt: int) -> Iterator[tuple[int, int]]:
    """Index ranges without a gap: no sample missing or with a `spoilt` flag, each force sent."""
    flags = trace.flags ^ _usual_flags(trace)
    broken = (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1) | (flags & spoilt != 0)
    broken[1:] |= flags[:-1] & UNSENT != 0
    starts = np.flatnonzero(broken | (np.arange(broken.size) == 0))
    for first, last in zip(starts, np.append(starts[1:], broken.size), strict=True):
        yield int(first), int(last)


def _usual_flags(trace: Trace) -> int:
    """LATE_FORCE where every force was late, as over a slow wire: that is a delay like any other, and a record like any
    other. What is out of the common is then a force in time."""
    late = trace.flags & LATE_FORCE != 0
    return LATE_FORCE if late.size and float(np.mean(late)) > _ALWAYS else 0
