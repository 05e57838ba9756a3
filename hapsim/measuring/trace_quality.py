"""The quality of a trace: its usable samples, and the rate at which the device took them.

A position arrives after it was sampled, never before. So only the earliest arrivals show the sample period (Moon,
Skelly and Towsley, *Estimation and removal of clock skew from network delay measurements*, 1999). The trace is divided
into some forty stretches. The rate is the median slope between the earliest arrivals of any two (Theil and Sen), so a
stretch in which the host was always late does not distort it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.number_format import plural
from hapsim.recording.trace import Report, Trace
from hapsim.units import Units

ROUNDING = 1.0 / math.sqrt(12.0)
"""Standard deviation of rounding to whole counts, counts."""

_ALWAYS = 0.99  # of all samples: if more forces are late, the wire's delay is the cause
_STRETCHES, _LEAST_STRETCHES, _LEAST_ROWS = 40, 10, 8
_CONFIDENCE = 0.999
_CLOCK = 1e-4  # relative error of the host's clock
_SPIKE_COUNTS, _SPIKE_LOUD, _SPIKE_SHAPE = 8.0, 20.0, 0.4
# The least height of a spike, in counts and in deviations of most samples; the share of it by which others may add.


def is_always_late(trace: Trace) -> bool:
    """Returns True if nearly every force was late, as over a slow wire: that is a constant delay."""
    late = trace.flags & LATE_FORCE != 0
    return bool(late.size) and float(np.mean(late)) > _ALWAYS


def unbroken(trace: Trace, spoilt: int) -> Iterator[tuple[int, int]]:
    """Yields index ranges without a gap: no sample is missing or has a `spoilt` flag, and each force was sent. If every
    force is late, one in time counts as spoilt. A late line spoils nothing if it is the line that acts meanwhile."""
    flags = trace.flags ^ (LATE_FORCE if is_always_late(trace) else 0)
    if trace.line_counts:
        flags = np.where(_continues_line(trace), flags ^ (flags & LATE_FORCE), flags)
    broken = (np.diff(trace.sample, prepend=trace.sample[:1] - 1) != 1) | (flags & spoilt != 0)
    broken[1:] |= flags[:-1] & UNSENT != 0
    starts = np.flatnonzero(broken | (np.arange(broken.size) == 0))
    for first, last in zip(starts, np.append(starts[1:], broken.size), strict=True):
        yield int(first), int(last)


def _continues_line(trace: Trace) -> NDArray[np.bool_]:
    """Returns for each row if the line that answers the row before is, but for rounding, that of two rows before."""
    k, b = (trace.line_counts[name].astype(float) for name in ("stiffness_counts", "damping_counts"))
    way = np.diff(trace.position_counts.astype(float), axis=0)
    along = k[1:] * way
    change = np.diff(trace.force_counts.astype(float), axis=0)
    moving = np.abs(along) >= np.max(np.abs(along), axis=0, initial=1.0) / 4.0
    unit = np.array([np.median(-change[m, c] / along[m, c]) if m.any() else 0.0 for c, m in enumerate(moving.T)])
    same = np.abs(change + unit * along) <= 1.0 + 0.5 * np.abs(unit * way)
    same &= (np.diff(k, axis=0) == 0) & (np.diff(b, axis=0) == 0)
    continued = np.zeros(trace.sample.size, bool)
    continued[2:] = same[:-1].all(axis=1)
    return continued


@dataclass(frozen=True)
class SeenRate:
    """The rate of the device's samples, Hz, and the half width of its 99.9 % interval. The host's clock is taken to be
    right to a ten-thousandth."""

    rate_hz: float
    uncertainty_hz: float

    def differs_from(self, rate_hz: float) -> bool:
        """Returns True if the rates differ by more than the uncertainty."""
        return abs(self.rate_hz - rate_hz) > self.uncertainty_hz


def seen_rate(trace: Trace) -> SeenRate | None:
    """Returns the rate at which the device sampled; None if too few positions arrived, or if its own timer did not pace
    them (virtual time, the host's clock, a mock in this process)."""
    stretches = min(_STRETCHES, trace.sample.size // _LEAST_ROWS)
    if not trace.report.timed_by_device or stretches < _LEAST_STRETCHES:
        return None
    number = (trace.sample - trace.sample[0]).astype(float)
    late = (trace.time_ns - trace.time_ns[0]) * 1e-9 - number / trace.rate
    slope = low = high = 0.0
    for _ in range(3):  # the earliest arrival of a stretch depends on the rate itself
        on_grid = late - slope * number
        earliest = [int(part[np.argmin(on_grid[part])]) for part in np.array_split(np.arange(number.size), stretches)]
        slope, low, high = median_slope(number[earliest], late[earliest])
    period = 1.0 / trace.rate + slope
    if not period > 0.0:
        return None
    spread = max(high - slope, slope - low) / period**2
    return SeenRate(float(1.0 / period), float(np.hypot(spread, _CLOCK / period)))


def median_slope(x: NDArray[np.float64], y: NDArray[np.float64]) -> tuple[float, float, float]:
    """Returns the median of the slopes between any two points, and its 99.9 % bounds (Sen, 1968)."""
    first, second = np.triu_indices(x.size, 1)
    slopes = np.sort((y[second] - y[first]) / (x[second] - x[first]))
    sigma = math.sqrt(x.size * (x.size - 1) * (2 * x.size + 5) / 18.0)
    reach = NormalDist().inv_cdf(0.5 + 0.5 * _CONFIDENCE) * sigma
    low, high = round(0.5 * (slopes.size - reach)) - 1, round(0.5 * (slopes.size + reach))
    return float(np.median(slopes)), float(slopes[max(low, 0)]), float(slopes[min(high, slopes.size - 1)])


def kept_rate(report: Report) -> SeenRate | None:
    """Returns the sample rate of a run from its first and newest sample; None for less than two. The uncertainty allows
    either of them the largest lateness of the run."""
    if not (report.duration_s > 0.0 and report.rate_hz > 0.0):
        return None
    if report.virtual_time:
        return SeenRate(report.rate_hz, 0.0)
    latest = (report.lateness_s.max or 0.0) + (report.exchange_s.max or 0.0)
    return SeenRate(report.rate_hz, report.rate_hz * float(np.hypot(latest / report.duration_s, _CLOCK)))


def spikes(traces: Sequence[Trace], channel: int) -> Iterator[str]:
    """Yields sentences if some positions lie alone, far off those before and after them, as no mass moves."""
    number, height, units = 0, 0.0, traces[0].report.units_of(channel)
    for trace in traces:
        counts = trace.position_counts[:, channel].astype(float)
        off = counts[1:-1] - 0.5 * (counts[:-2] + counts[2:])
        if off.size >= _LEAST_ROWS:
            here = np.abs(off[1:-1])
            beside = np.maximum(*(np.abs(off[1:-1] + 2.0 * one) for one in (off[:-2], off[2:])))
            alone = here > max(_SPIKE_COUNTS, _SPIKE_LOUD * float(np.quantile(np.abs(off), 0.9)))
            alone &= (beside < _SPIKE_SHAPE * here) & (trace.sample[4:] - trace.sample[:-4] == 4)
            number, height = number + int(np.sum(alone)), float(np.max(here, initial=height, where=alone))
    if number:
        most = units(height * float(traces[0].position_scale[channel]), "m", ".2g")
        yield (
            f"The position has spikes: {plural(number, 'sample')} lay alone, at most {most} "
            "off those before and after. The sensor is read while it changes, or disturbed. Each makes the force jump, "
            "and the values are less certain than stated."
        )


def silence(trace: Trace, channel: int) -> str:
    """Returns sentences (without the last full stop) about a position that did not change while force acted; "" if it
    did, or if no force acted."""
    acted = np.count_nonzero(trace.force_counts[:, channel])
    if not acted or np.ptp(trace.position_counts[:, channel]):
        return ""
    return silence_words(
        acted / trace.rate, float(np.abs(trace.force[:, channel]).max()), trace.report.units_of(channel)
    )


@contextmanager
def explained(trace: Trace, channel: int, failure: Exception | None) -> Iterator[None]:
    """Raises `failure`, or else why the position is silent, in place of a UsageError of the identification within."""
    try:
        yield
    except UsageError as nothing:
        if failure is not None:
            raise failure from nothing
        if reason := silence(trace, channel):
            raise UsageError(reason) from nothing
        raise


def silence_words(seconds: float, force: float, units: Units) -> str:
    """Returns these sentences for a force that acted for `seconds`, of at most `force` N."""
    return (
        f"the position has not changed by one count for {seconds:.2g} s while force acts ({units(force, 'N', '.3g')} "
        "at most): sensor or cable? Move the device by hand while `hapsim run` shows the position. If it changes, the "
        "device is held, stuck by dry friction, or its motor does not push: only then allow more with --push"
    )
