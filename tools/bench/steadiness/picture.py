"""The picture: exchanges per second, wake-up latency, deadline misses, side by side."""

from __future__ import annotations

import statistics
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.chart.figure import figure_to
from steadiness.parts import EXCHANGES, LATE, WAKEUPS
from steadiness.record import COMPILED, CYCLICTEST, FIFO, PORTABLE, C, Case, Records

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = {C: "0.35", COMPILED: "#d95f0e", PORTABLE: "#fec44f", CYCLICTEST: "#2b6ca3"}
_ON_DEVICE = (C, COMPILED, PORTABLE)
_SLEEPING = (C, COMPILED, CYCLICTEST)
_BAR = 0.26


def draw(records: Records, path: Path) -> None:
    """Draws what was measured; a part that was not stays empty. The ending of `path` chooses SVG, PNG or PDF."""
    with figure_to(path, 11.0, 3.9) as figure:
        left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 1.25, 1.0))
        _bars(left, records, EXCHANGES, "exchanges_per_second", "{:,.0f}")
        left.set_xscale("log")
        left.set_xlim(left=10.0)
        left.set_xlabel("exchanges per second")
        _lateness(middle, records)
        _bars(right, records, LATE, "late_percent", "{:.2g} %")
        right.set_xscale("symlog", linthresh=0.1)
        right.set_xlim(0.0, 1000.0)
        right.set_xticks([0.0, 0.1, 1.0, 10.0, 100.0])
        right.xaxis.set_major_formatter(_plain)
        right.set_xlabel("forces too late at 1 kHz, %")
        _legend(figure, records)


def _plain(value: float, _position: object) -> str:
    return f"{value:g}"


def _plain_where_rare(value: float, _position: object) -> str:
    """Between the powers of ten: 2 and 5 alone."""
    return f"{value:g}" if f"{value:e}"[0] in "25" else ""


def _bars(axes: Axes, records: Records, part: str, quantity: str, form: str) -> None:
    """A group of bars a load, a bar a peer, with its range."""
    cases = records.cases(part)
    for row, case in enumerate(cases):
        for i, peer in enumerate(_ON_DEVICE):
            values = records.values(case, peer, quantity)
            if values:
                _bar(axes, row + (i - 1) * _BAR, values, _COLOURS[peer], form)
    axes.set_yticks(range(len(cases)), [case.load.replace(" ", "\n") for case in cases])
    axes.invert_yaxis()
    axes.margins(x=0.25)
    axes.spines[["top", "right"]].set_visible(False)


def _bar(axes: Axes, y: float, values: list[float], colour: str, form: str) -> None:
    middle = statistics.median(values)
    axes.barh(y, middle, height=0.9 * _BAR, color=colour)
    axes.plot([min(values), max(values)], [y, y], color="black", linewidth=1.0)
    axes.annotate(form.format(middle), (max(values), y), (4, 0), textcoords="offset points", va="center", fontsize=8)


def _lateness(axes: Axes, records: Records) -> None:
    """A stroke from p50 to p99 for each peer and rate; a hollow end where the scheduling was real-time."""
    cases = records.cases(WAKEUPS)
    rates = sorted({case.rate_hz for case in cases})
    for case in cases:
        for i, peer in enumerate(_SLEEPING):
            x = rates.index(case.rate_hz) + (i - 1) * 0.13 + (0.21 if case.scheduling == FIFO else -0.21)
            _stroke(axes, x, records, case, peer)
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullLocator

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 3.0, 4.0, 6.0)))
    axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(_plain)
    axes.yaxis.set_minor_formatter(_plain_where_rare)
    axes.set_xticks(range(len(rates)), [f"{rate / 1000:g} kHz" for rate in rates])
    axes.set_ylabel("wake-up latency, µs: p50 to p99")
    axes.set_xlabel("filled: ordinary scheduling; hollow: SCHED_FIFO")
    axes.grid(axis="y", color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _stroke(axes: Axes, x: float, records: Records, case: Case, peer: str) -> None:
    ends = [records.values(case, peer, quantity) for quantity in ("p50_us", "p99_us")]
    if not all(ends):
        return
    y = [statistics.median(values) for values in ends]
    face: Any = "white" if case.scheduling == FIFO else _COLOURS[peer]
    axes.plot([x, x], y, color=_COLOURS[peer], linewidth=1.6, marker="o", markersize=4, markerfacecolor=face)


def _legend(figure: Any, records: Records) -> None:
    from matplotlib.patches import Patch

    there = {record.peer for record in records.all}
    handles = [Patch(color=colour, label=peer) for peer, colour in _COLOURS.items() if peer in there]
    figure.legend(handles=handles, loc="outside upper center", ncols=len(handles), frameon=False)
