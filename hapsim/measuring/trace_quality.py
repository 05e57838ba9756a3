"""What a trace says of its own samples: which of them are usable, and at which rate the device took them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.recording.trace import Report, Trace

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


_STRETCHES, _LEAST_STRETCHES, _LEAST_ROWS = 40, 10, 8
_CONFIDENCE = 0.999
_CLOCK = 1e-4  # the host's own clock, and how it is led to the true time, is right to this share


@dataclass(frozen=True)
class SeenRate:
    """The rate (Hz) of the samples that arrived, and the half width of the interval that holds it with 99.9 %, the
    host's clock taken to be right to a ten-thousandth."""

    rate_hz: float
    uncertainty_hz: float

    def differs_from(self, rate_hz: float) -> bool:
        """Whether it is another rate, by more than its uncertainty."""
        return abs(self.rate_hz - rate_hz) > self.uncertainty_hz


def seen_rate(trace: Trace) -> SeenRate | None:
    """The rate at which the device sampled; None where the device's own timer did not pace the positions (in virtual
    time, by the host's clock, on a mock in this process), or too few came to tell."""
    from scipy.stats import theilslopes

    if not trace.report.timed_by_device:
        return None
    stretches = min(_STRETCHES, trace.sample.size // _LEAST_ROWS)
    if stretches < _LEAST_STRETCHES:
        return None
    number = (trace.sample - trace.sample[0]).astype(float)
    late = (trace.time_ns - trace.time_ns[0]) * 1e-9 - number / trace.rate
    slope, low, high = 0.0, 0.0, 0.0
    for _ in range(3):  # which arrival is a stretch's earliest depends on the rate itself
        on_grid = late - slope * number
        earliest = [int(part[np.argmin(on_grid[part])]) for part in np.array_split(np.arange(number.size), stretches)]
        slope, _, low, high = theilslopes(late[earliest], number[earliest], _CONFIDENCE)
    period = 1.0 / trace.rate + slope
    if not period > 0.0:
        return None
    spread = max(high - slope, slope - low) / period**2
    return SeenRate(float(1.0 / period), float(np.hypot(spread, _CLOCK / period)))


def kept_rate(report: Report) -> SeenRate | None:
    """The rate of the samples that a run took, without the arrival of each: from the first to the newest, of which
    either may have come later than it ought to by as much as the latest of all. None of a run of less than two."""
    if not (report.duration_s > 0.0 and report.rate_hz > 0.0):
        return None
    if report.virtual_time:
        return SeenRate(report.rate_hz, 0.0)
    latest = (report.lateness_s.max or 0.0) + (report.exchange_s.max or 0.0)
    return SeenRate(report.rate_hz, report.rate_hz * float(np.hypot(latest / report.duration_s, _CLOCK)))
