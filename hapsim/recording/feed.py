"""The rows of a running loop for the programs that follow it: samples in SI units, without gaps."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError

_WAIT_S = 0.1  # between two looks at whether the run is over


@dataclass(frozen=True)
class Samples:
    """N samples of C channels, in the order in which the positions arrived."""

    sample: NDArray[np.int64]
    """(N,) the device's number of each position, counted from arming."""
    time_ns: NDArray[np.int64]
    """(N,) monotonic time at which it arrived."""
    flags: NDArray[np.uint8]
    """(N,) of hapsim.loop.ring."""
    position: NDArray[np.float64]
    """(N, C) m."""
    velocity: NDArray[np.float64]
    """(N, C) m/s: the backward difference of the positions."""
    force: NDArray[np.float64]
    """(N, C) N, that was sent."""

    def __len__(self) -> int:
        return int(self.sample.size)


class Scales:
    """Rows of `row_type` -> `Samples`, one piece after the other.

    `rate`: Hz; `position_scale`, `force_scale`: (C,) m and N per count."""

    def __init__(self, rate: float, position_scale: NDArray[np.float64], force_scale: NDArray[np.float64]) -> None:
        self._rate, self._position, self._force = rate, position_scale, force_scale
        self._before: NDArray[Any] | None = None  # the last row of the piece before

    def samples(self, rows: NDArray[Any]) -> Samples:
        """Returns the samples of the rows that follow those of the last call."""
        before = rows[:1] if self._before is None else self._before
        if rows.size:
            self._before = rows[-1:].copy()
        counts = np.concatenate([before, rows])["position_counts"].astype(np.float64)
        apart = np.maximum(np.diff(rows["sample"], prepend=before["sample"]), 1)
        return Samples(
            sample=rows["sample"].copy(),
            time_ns=rows["time_ns"].copy(),
            flags=rows["flags"].copy(),
            position=rows["position_counts"] * self._position,
            velocity=np.diff(counts, axis=0) * self._position * self._rate / apart[:, None],
            force=rows["force_counts"] * self._force,
        )


class Stream:
    """An iterator over the `Samples` of a run from now on, every one; it ends with the run.

    It keeps what was not taken yet. In real time it gives up `longest` rows behind: then `next` raises UsageError."""

    def __init__(self, scales: Scales, longest: int | None, is_over: Any, collect: Any) -> None:
        """`longest`: None for no limit, in virtual time. `is_over()`: whether no more rows come. `collect()`: fetches
        the newest ones."""
        self._scales, self._longest, self._is_over, self._collect = scales, longest, is_over, collect
        self._waiting: deque[NDArray[Any]] = deque()
        self._count, self._lost = 0, 0
        self._news = threading.Condition()

    def put(self, rows: NDArray[Any]) -> None:
        """Adds rows; called by the thread that empties the ring."""
        with self._news:
            if self._longest is not None and self._count + rows.size > self._longest:
                self._lost += self._count + rows.size
                self._waiting.clear()
                self._count = 0
            else:
                self._waiting.append(rows)
                self._count += rows.size
            self._news.notify_all()

    def __iter__(self) -> Iterator[Samples]:
        return self

    def __next__(self) -> Samples:
        while True:
            was_over = self._is_over()
            if (samples := self.take()) is not None:
                return samples
            if was_over:
                raise StopIteration
            with self._news:
                self._news.wait_for(lambda: self._count > 0 or self._lost > 0, _WAIT_S)

    def take(self, most: int | None = None) -> Samples | None:
        """Returns the samples since the last call, the first `most` of them, without waiting for more; None where there
        are none. UsageError where some were lost."""
        self._collect()
        with self._news:
            lost, self._lost = self._lost, 0
            left, rows = self._count if most is None else min(most, self._count), []
            self._count -= left
            while left:
                piece = self._waiting.popleft()
                rows.append(piece[:left])
                if piece.size > left:
                    self._waiting.appendleft(piece[left:])
                left -= rows[-1].size
        if lost:
            raise UsageError(f"the stream was read too late: {lost} samples are lost. Read it more often")
        return self._scales.samples(np.concatenate(rows)) if rows else None
