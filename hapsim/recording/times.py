"""Times of a record: the clock of its arrivals, the time of each row, and its markers."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.recording.report import Report

_TRIES = 20  # the tightest of them counts
_STRETCH_S = 0.25  # of which the earliest arrival counts


class Clock(NamedTuple):
    """The host's clock of all times in ns, and how the system's real time lay to it when the record began."""

    name: str
    """As Python names it: "clock_gettime(CLOCK_MONOTONIC)" on Linux."""
    realtime_offset_ns: int
    """Real time (since 1970, UTC) less this clock."""
    uncertainty_ns: int
    """Largest error of that offset."""


def offset_of(read_ns: Callable[[], int]) -> tuple[int, int]:
    """Returns what another clock shows less the monotonic one, and the largest error of that, in ns."""
    reads = [(time.monotonic_ns(), read_ns(), time.monotonic_ns()) for _ in range(_TRIES)]
    before, other, after = min(reads, key=lambda one: one[2] - one[0])
    return other - (before + after) // 2, (after - before + 1) // 2


def clock_now() -> Clock:
    """Returns the clock of the loop, compared with the real time now."""
    return Clock(time.get_clock_info("monotonic").implementation, *offset_of(time.time_ns))


class Marker(NamedTuple):
    """A marker of a run."""

    sample: int
    """Device's number of the newest position when it was set."""
    text: str
    at: str = ""
    """Time, UTC, ISO 8601."""


def markers_of(notes: Iterable[dict[str, Any]]) -> tuple[Marker, ...]:
    """Returns the markers among a record's notes."""
    return tuple(Marker(one["sample"], one["marker"], one.get("at", "")) for one in notes if "marker" in one)


def trials_of(notes: Iterable[dict[str, Any]]) -> tuple[tuple[int, int], ...]:
    """Returns the first sample and the number of each trial among a record's notes."""
    return tuple((one["sample"], one["trial"]) for one in notes if "trial" in one)


def trial_at(trials: Iterable[tuple[int, int]], sample: NDArray[np.int64]) -> NDArray[np.int64]:
    """Returns the number of the trial at each sample; 0 before the first. `trials`: as from `trials_of`."""
    first, number = np.array([(-1, 0), *trials], np.int64).T
    return number[np.searchsorted(first, sample, side="right") - 1]


class Timeline:
    """Times of a record's rows, in s since its first row, on the host's clock.

    By `source`: "count", in virtual time: the device's count of samples over the nominal rate. "arrivals": those of the
    positions. "device", where a device's own timer paces: a position arrives after it was sampled, never before, so the
    earliest arrival of each quarter of a second is a point of the device's clock, and lines join these points
    (`hapsim.measuring.trace_quality` finds the rate in the same way).
    """

    def __init__(self, rate: float, report: Report, pieces: Iterable[tuple[NDArray[np.int64], NDArray[Any]]]) -> None:
        """Reads the `pieces` of a record, each (samples, their arrivals in ns)."""
        self.source = "count" if report.virtual_time else "device" if report.timed_by_device else "arrivals"
        """Origin of the times: "count", "device" or "arrivals"."""
        self.start_ns = 0
        """Time 0 on the host's clock."""
        self.last = -1
        """The last row's sample."""
        self._rate, self._first, self._first_ns = rate, 0, 0
        earliest: dict[int, tuple[float, int]] = {}  # of each stretch: lateness to the nominal grid in ns, sample
        stretch = max(round(_STRETCH_S * rate), 1)
        for sample, time_ns in pieces:
            if self.last < 0 and sample.size:
                self._first, self._first_ns = int(sample[0]), int(time_ns[0])
            self.last = int(sample[-1]) if sample.size else self.last
            late, number = (
                time_ns - self._first_ns - (sample - self._first) * 1e9 / rate,
                (sample - self._first) // stretch,
            )
            begins = np.flatnonzero(np.diff(number, prepend=-1)).tolist() if self.source == "device" else []
            for begin, end in itertools.pairwise([*begins, sample.size]):
                best, n = begin + int(np.argmin(late[begin:end])), int(number[begin])
                earliest[n] = min(earliest.get(n, (np.inf, 0)), (float(late[best]), int(sample[best])))
        self._points, late = _to_ends(earliest.values(), self._first, self.last, stretch)
        self._late, self.start_ns = late - late[0], self._first_ns + round(late[0])

    def of(self, sample: NDArray[np.int64], time_ns: NDArray[Any]) -> NDArray[np.float64]:
        """Returns the times of rows, s."""
        if self.source == "arrivals":
            return np.asarray(time_ns - self._first_ns) * 1e-9
        late_ns = np.interp(sample, self._points, self._late)
        return np.asarray((sample - self._first) / self._rate + late_ns * 1e-9)


def _to_ends(
    points: Iterable[tuple[float, int]], first: int, last: int, stretch: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Returns samples and latenesses of points, extended to a record's ends with their mean slope."""
    late, sample = np.array([*points] or [(0.0, first)], float).T
    span = sample[-1] - sample[0]  # points side by side have no slope to speak of
    slope = (late[-1] - late[0]) / span if span > stretch else 0.0
    ends = late[[0, -1]] + slope * (np.array([first, last]) - sample[[0, -1]])
    return np.r_[first, sample, last], np.r_[ends[0], late, ends[1]]


def rows_of(
    markers: Iterable[Marker], sample: NDArray[np.int64], before: int, last: int
) -> Iterator[tuple[int, Marker]]:
    """Yields the row of each marker that belongs to a piece of a record: the first one not before its sample.

    `sample`: (N,) of the piece; `before`: the last sample of the piece before, -1 at the beginning; `last`: the
    record's last one, to whose row later markers belong."""
    for one in markers:
        place = min(one.sample, last)
        if sample.size and before < max(place, 0) <= sample[-1]:
            yield int(np.searchsorted(sample, place)), one
