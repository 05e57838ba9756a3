"""The ring's reader: gathers rows outside of the loop, for a trace in memory, for a file, for the last second."""

from __future__ import annotations

import threading
from collections import deque
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.loop.ring import Ring, RingRows
from hapsim.recording.recording import Recording
from hapsim.recording.report import Report, Statistics
from hapsim.recording.stream import ROWS
from hapsim.recording.streamed_trace import as_rows
from hapsim.recording.trace import Trace


class Recorder:
    """Collects what the ring holds. `keep`: False frees the rows without keeping them, but for the last `recent` ones
    or a few more."""

    def __init__(self, ring: Ring, keep: bool, recent: int = 1) -> None:
        self._ring = ring
        self._keep = keep
        self._recent = recent
        self._lock = threading.Lock()
        self._nothing = ring.drain()
        self._parts: list[RingRows] = []
        self._last: deque[RingRows] = deque()
        self.recording: Recording | None = None
        """The file that is written meanwhile, if any."""

    def collect(self) -> None:
        """Takes what is in the ring now; from any thread."""
        with self._lock:
            part = self._ring.drain()
            if not part.sample.size:
                return
            if self._keep:
                self._parts.append(part)
            self._last.append(part)
            while sum(one.sample.size for one in self._last) - self._last[0].sample.size >= self._recent:
                self._last.popleft()
            if self.recording is not None:
                rows = as_rows(part, part.position.shape[1])
                self.recording.put(rows, patient=bool(self._ring.record.waits))

    def trace(
        self,
        rate: float,
        position_scale: NDArray[np.float64],
        force_scale: NDArray[np.float64],
        statistics: Statistics,
        report: Report,
    ) -> Trace:
        """Everything kept, as one trace."""
        rows = _joined([self._nothing, *self._parts])
        return Trace(
            rate=rate,
            sample=rows.sample,
            time_ns=rows.time_ns,
            flags=rows.flags,
            position_counts=rows.position,
            force_counts=rows.force,
            asked_force=rows.asked,
            position_scale=position_scale,
            force_scale=force_scale,
            statistics=statistics,
            report=report,
        )

    def last_rows(self) -> dict[str, Any]:
        """The columns of the `recent` rows that came last, by their names in a trace."""
        rows: tuple[NDArray[Any], ...] = _joined([self._nothing, *self._last])
        return {name: column[-self._recent :] for name, column in zip(ROWS, rows, strict=True)}


def _joined(parts: list[RingRows]) -> RingRows:
    return RingRows(*(np.concatenate(column) for column in zip(*parts, strict=True)))
