"""What was recorded: position and force over time, channel by channel."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.chart.figure import figure_to
from hapsim.loop.ring import BRIDGED, LATE_FORCE, LIMITED, UNSENT, WITHHELD
from hapsim.recording.trace import Trace

_STRETCHES = 2000  # of more rows than that, the least and the greatest of each stretch are drawn: no peak is lost
_MARKED = (
    ("late", "|", LATE_FORCE, 0),
    ("never sent", "x", UNSENT, 0),
    ("withheld, zero sent", "o", WITHHELD, UNSENT),
    ("at its limit", "v", LIMITED, WITHHELD),
    ("positions lost before", "+", BRIDGED, 0),
)
"""What is marked in the picture, how, and the rows: those with the one flag and without the other, which says more."""


def seconds_of(trace: Trace) -> NDArray[np.float64]:
    """(N,) s since arming, by the device's count of samples, as `hapsim frames` and a run's sentence count."""
    return trace.sample / trace.rate


def marked_rows(trace: Trace) -> dict[str, NDArray[np.intp]]:
    """The rows that are marked in a picture, by what is said of them."""
    return {
        what: np.flatnonzero((trace.flags & flag != 0) & (trace.flags & but == 0)) for what, _, flag, but in _MARKED
    }


def columns_of(trace: Trace) -> dict[str, NDArray[Any]]:
    """What is drawn, row by row, by the names that a data file uses; and when each arrived, by the host's clock, since
    the first."""
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
    """Draws it; rows whose force was late, cut, withheld or never sent are marked. The ending of `path` chooses SVG,
    PNG or PDF."""
    time = seconds_of(trace)
    with figure_to(path, 8.0, 5.2) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True)
        for axes, values, label in (
            (upper, 1e3 * trace.position, "position (mm)"),
            (lower, trace.force, "force (N)"),
        ):
            for c in range(values.shape[1]):
                drawn = _least_and_greatest(values[:, c])
                axes.plot(time[drawn], values[drawn, c], lw=1.0, label=f"channel {c}")
            axes.axhline(0.0, color="black", linewidth=0.5)
            axes.set_ylabel(label)
            axes.margins(x=0.01)
        for (what, sign, *_), marked in zip(_MARKED, marked_rows(trace).values(), strict=True):
            drawn = marked[_spread(marked.size)]
            if marked.size:
                look = {"ms": 5, "ls": "", "color": "black", "fillstyle": "none"}
                lower.plot(time[drawn], trace.force[drawn, 0], sign, label=f"{what}: {marked.size}", **look)
        lower.set_xlabel(f"time since arming (s): sample number / {trace.rate:g} Hz")
        lower.ticklabel_format(axis="x", style="plain", useOffset=False)  # each number can be compared as it is
        upper.set_title(title, fontsize=9)
        figure.legend(*lower.get_legend_handles_labels(), loc="outside lower left", ncols=4, frameon=False)


def _least_and_greatest(values: NDArray[np.float64]) -> NDArray[np.int64]:
    """Which rows are drawn: all, or of each stretch the one with the least and the one with the greatest value."""
    if values.size <= 2 * _STRETCHES:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, _STRETCHES + 1).astype(np.int64)
    of: tuple[Callable[..., Any], ...] = (np.argmin, np.argmax)
    rows = [a + of_stretch(values[a:b]) for a, b in pairwise(edges) for of_stretch in of]
    return np.unique(rows)


def _spread(count: int) -> NDArray[np.int64]:
    return np.unique(np.linspace(0, max(count - 1, 0), min(count, _STRETCHES)).astype(np.int64))
