"""The picture of `hapsim doctor`: the share of wake-ups and exchanges that take longer than a time, rate by rate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.loop.histogram import Histogram
from hapsim.number_format import frequency, short_duration
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from hapsim.doctor.examine import Examination


@dataclass(frozen=True)
class Survival:
    """A survival curve: which share of something took longer than a time."""

    what: str  # lateness (of wake-ups) or exchange
    rate_hz: float
    clock: str  # "" for wake-ups without a loop
    time: Floats  # s, (n,), rising
    share: Floats  # 0 to 1: what took longer than every time from the one before up to that


def steadiness(examination: Examination) -> list[Survival]:
    """Returns the curves of an examination: of the latency of bare wake-ups, and of the exchanges' times."""
    curves = [_survival("lateness", rate, "", histogram) for rate, histogram in examination.wakeups.items()]
    for run in examination.exchanges:
        if run.exchange is not None:
            curves.append(_survival("exchange", run.rate_hz, run.clock, run.exchange))
    return [curve for curve in curves if curve.time.size]


def _survival(what: str, rate: float, clock: str, histogram: Histogram) -> Survival:
    """Reads a histogram at the end of every bin that holds something, so that no time is given too short. What took no
    time at all has no place on a logarithmic axis."""
    filled = np.flatnonzero(histogram.counts[1:]) + 1
    if filled.size == 0:
        return Survival(what, rate, clock, np.empty(0), np.empty(0))
    at_least = (histogram.counts[::-1].cumsum()[::-1] / histogram.total)[filled]
    times = np.append(histogram.edges[filled[0]], histogram.edges[filled + 1])
    return Survival(what, rate, clock, np.minimum(times, histogram.maximum), np.append(at_least[0], at_least))


def columns(curves: list[Survival]) -> dict[str, list[Any]]:
    """Returns what is drawn, by the names that a data file uses: a row for each point."""
    names = ("what", "clock", "rate_Hz", "longer_than_s", "share")
    points = [
        (curve.what, curve.clock, curve.rate_hz, time, share)
        for curve in curves
        for time, share in zip(curve.time.tolist(), curve.share.tolist(), strict=True)
    ]
    return {name: [point[i] for point in points] for i, name in enumerate(names)}


def draw_steadiness(curves: list[Survival], title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    rates = sorted({curve.rate_hz for curve in curves})
    shades = mpl.colormaps[style.RATES](np.linspace(0.0, style.LIGHTEST_RATE, len(rates)))
    shade_of = dict(zip(rates, map(tuple, shades), strict=True))
    clocks = sorted({curve.clock for curve in curves if curve.clock})
    looks: list[tuple[Any, Any, str]] = [(shade, "-", frequency(rate)) for rate, shade in shade_of.items()]
    looks += [("0.4", style.CLOCKS[clock], f"clock: {clock}") for clock in clocks]
    looks.append(("0.4", ":", "a period of that rate"))
    with figure_to(path, 8.0, 4.2) as figure:
        figure.suptitle(title)
        left, right = figure.subplots(1, 2, sharey=True)
        _draw(left, [curve for curve in curves if curve.what == "lateness"], shade_of)
        _draw(right, [curve for curve in curves if curve.what == "exchange"], shade_of)
        left.set(xlabel="wake-up latency above", ylabel="share of ticks")
        left.set_ylim(0.6 * min(curve.share[-1] for curve in curves), 1.5)
        right.set_xlabel("exchange takes longer than")
        handles = [
            Line2D([], [], color=color, linestyle=dashes, linewidth=1.3, label=label) for color, dashes, label in looks
        ]
        legend_below(figure, len(handles), handles=handles, columnspacing=1.2)


def _draw(axes: Axes, curves: list[Survival], shade_of: dict[float, Any]) -> None:
    axes.set(xscale="log", yscale="log")
    for curve in curves:
        look = {"color": shade_of[curve.rate_hz], "linewidth": 1.3, "linestyle": style.CLOCKS[curve.clock]}
        axes.step(curve.time, curve.share, where="pre", **look)
    for rate in {curve.rate_hz for curve in curves}:
        axes.axvline(1.0 / rate, color=shade_of[rate], linewidth=0.9, linestyle=":", zorder=1.5)
    axes.xaxis.set_major_formatter(lambda t, _: short_duration(t))
    axes.yaxis.set_major_formatter(lambda share, _: f"{100.0 * share:.4g} %")
    axes.grid()
