"""Sleeping to a grid, and nothing else: how late the machine wakes up a loop, without a loop."""

from __future__ import annotations

import numpy as np

from hapsim.compiling import entry
from hapsim.loop.histogram import HISTOGRAM, note
from hapsim.loop.pacing import next_point
from hapsim.loop.system import SCRATCH, now_ns, sleep_until

GRID = np.dtype(
    [
        ("stop", np.int64),  # set by another thread, looked at after each wake-up
        ("due_ns", np.int64),  # the next point of the grid
        ("end_ns", np.int64),  # the last one
        ("period_ns", np.int64),
        ("wakeups", np.int64),
        ("restarts", np.int64),  # how often the grid started anew, a whole period late
        ("lateness", HISTOGRAM),  # ns
        SCRATCH,
    ],
    align=True,
)


@entry
def sleep_on_grid(grid):
    """Sleeps to every point of a grid (a GRID record) and counts the wake-up latencies, in ns."""
    while grid.due_ns <= grid.end_ns and not grid.stop:
        sleep_until(grid.due_ns, grid.scratch)
        now = now_ns(grid.scratch)
        note(grid.lateness, now - grid.due_ns)
        grid.wakeups += 1
        grid.due_ns, missed = next_point(grid.due_ns, now, grid.period_ns)
        grid.restarts += missed
