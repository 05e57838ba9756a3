"""The ring's reader: gathers rows into a trace, outside of the loop."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hapsim.loop.ring import Ring, RingRows
from hapsim.loop.trace import Report, Statistics, Trace


class Recorder:
    """Collects what the ring holds. `keep`: False frees the rows without keeping them."""

    def __init__(self, ring: Ring, keep: bool) -> None:
        self._ring = ring
        self._keep = keep
        self._parts = [ring.drain()]

    def collect(self) -> None:
        """Takes what is in the ring now."""
        part = self._ring.drain()
        if self._keep and part.sample.size:
            self._parts.append(part)

    def trace(
        self,
        rate: float,
        position_scale: NDArray[np.float64],
        force_scale: NDArray[np.float64],
        statistics: Statistics,
        report: Report,
    ) -> Trace:
        """Everything collected, as one trace."""
        rows = RingRows(*(np.concatenate(column) for column in zip(*self._parts, strict=True)))
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
