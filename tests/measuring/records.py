"""Records made from arrays."""

from __future__ import annotations

import numpy as np

from firmware_protocol.records import new_record
from hapsim.loop.histogram import HISTOGRAM, histogram_of
from hapsim.loop.trace import Report, Statistics, Trace

QUANTUM = 1e-9


def trace_of(position: np.ndarray, asked: np.ndarray, rate: float = 1000.0) -> Trace:
    """A trace of one channel, rounded to counts of a nanometre; every force as asked."""
    n = position.size
    nothing = histogram_of(new_record(HISTOGRAM))
    statistics = Statistics(nothing, nothing, nothing)
    spreads = (nothing.spread(),) * 3
    report = Report("done", n, n / rate, rate, rate, 0, 0, 0, 0, 0, 0, 0, *spreads, virtual_time=True)
    force_scale = 1e-8
    counts = np.rint(position / QUANTUM).astype(np.int32)[:, None]
    return Trace(
        rate=rate,
        sample=np.arange(n),
        time_ns=np.arange(n),
        flags=np.zeros(n, np.uint8),
        position_counts=counts,
        force_counts=np.rint(asked / force_scale).astype(np.int32)[:, None],
        asked_force=asked[:, None],
        position_scale=np.array([QUANTUM]),
        force_scale=np.array([force_scale]),
        statistics=statistics,
        report=report,
    )
