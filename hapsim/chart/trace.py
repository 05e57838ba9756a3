"""What was recorded: position and force over time, channel by channel."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED, UNSENT, WITHHELD
from hapsim.recording.trace import Trace

_MOST_MARKS = 2000
_MARKS = (
    ("late", "|", LATE_FORCE, 0),
    ("never sent", "x", UNSENT, 0),
    ("withheld, zero sent", "o", WITHHELD, UNSENT),
    ("at its limit", "v", LIMITED, WITHHELD),
    ("positions lost before", "+", BRIDGED, 0),
)
"""What is marked, its marker, and which rows: those with the first flag and without the second, which says more."""


def seconds_of(trace: Trace) -> NDArray[np.float64]:
    """Returns (N,) s since arming by the device's count of samples, as `hapsim frames` and a run's sentences count."""
    return trace.sample / trace.rate


def marked_rows(trace: Trace) -> dict[str, NDArray[np.intp]]:
    """Returns the rows that are marked, by their label in the legend."""
    return {
        what: np.flatnonzero((trace.flags & flag != 0) & (trace.flags & unless == 0))
        for what, _, flag, unless in _MARKS
    }


def columns_of(trace: Trace) -> dict[str, NDArray[Any]]:
    """Returns what is drawn, row by row, by the names that a data file uses; `arrived_s` is by the host's clock, since
    the first row."""
    columns: dict[str, NDArray[Any]] = {
        "time_s": seconds_of(trace),
        "sample": trace.sample,
        "arrived_s": (trace.time_ns - trace.time_ns[:1]) * 1e-9,
        "flags": trace.flags,
    }
    for c in range(trace.position_scale.size):
        columns |= {f"position_m[{c}]": trace.position[:, c], f"force_N[{c}]": trace.force[:, c]}
    return columns


def draw_trace(trace: Trace, title: str, path: Path) -> None:
    """Draws it to a file (.svg, .png or .pdf), with a mark where a force was late, limited, withheld or never sent."""
    time = seconds_of(trace)
    with figure_to(path, 8.0, 5.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, values, label in ((upper, 1e3 * trace.position, "position (mm)"), (lower, trace.force, "force (N)")):
            for c in range(values.shape[1]):
                axes.plot(time, values[:, c], linewidth=1.0, label=f"channel {c}")
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        for (what, marker, *_), marked in zip(_MARKS, marked_rows(trace).values(), strict=True):
            drawn = marked[:: max(1, marked.size // _MOST_MARKS)]
            if marked.size:
                lower.plot(time[drawn], trace.force[drawn, 0], marker, label=f"{what}: {marked.size}", **style.MARK)
        for axes in (upper, lower):
            draw_zero_if_near(axes)
        lower.set_xlabel(f"time since arming (s): sample number / {trace.rate:g} Hz")
        lower.ticklabel_format(axis="x", style="plain", useOffset=False)  # each number can be compared as it is
        upper.set_title(title, fontsize=9)
        legend_below(figure, 4)


def draw_zero_if_near(axes: Axes) -> None:
    """Draws a line at zero where the data come near it; elsewhere the axis would show little else."""
    low, high = axes.get_ylim()
    if low <= 0.0 <= high:
        axes.axhline(0.0, **style.ZERO_LINE)
