"""The picture of `hapsim doctor`: which share of wake-ups and exchanges takes longer than a time, rate by rate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.number_format import frequency, short_duration
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hapsim.doctor.examine import Examination
    from hapsim.loop.histogram import Histogram

What = Literal["lateness", "exchange"]


@dataclass(frozen=True)
class Survival:
    """A survival curve: which share of something took longer than a time."""

    what: What
    rate_hz: float
    clock: str
    """"" for wake-ups without a loop."""
    time: Floats
    """s, (n,), rising."""
    share: Floats
    """0 to 1: what took longer than every time from the one before up to that."""


def steadiness(examination: Examination) -> list[Survival]:
    """Returns the curves of an examination: of the latency of bare wake-ups, and of the exchanges' times."""
    curves = [_survival("lateness", rate, "", histogram) for rate, histogram in examination.wakeups.items()]
    for run in examination.exchanges:
        if run.exchange is not None:
            curves.append(_survival("exchange", run.rate_hz, run.clock, run.exchange))
    return [curve for curve in curves if curve.time.size]


def _survival(what: What, rate: float, clock: str, histogram: Histogram) -> Survival:
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
    points = [(curve, float(t), float(s)) for curve in curves for t, s in zip(curve.time, curve.share, strict=True)]
    return {
        "what": [curve.what for curve, _, _ in points],
        "clock": [curve.clock for curve, _, _ in points],
        "rate_Hz": [curve.rate_hz for curve, _, _ in points],
        "longer_than_s": [t for _, t, _ in points],
        "share": [s for _, _, s in points],
    }


def draw_steadiness(curves: list[Survival], title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    import matplotlib as mpl
    from matplotlib.lines import Line2D

    rates = sorted({curve.rate_hz for curve in curves})
    shades = dict(
        zip(rates, mpl.colormaps[style.RATES](np.linspace(0.0, style.LIGHTEST_RATE, len(rates))), strict=True)
    )

    def sample(color: Any, linestyle: Any, label: str) -> Line2D:
        return Line2D([], [], color=color, linestyle=linestyle, linewidth=1.3, label=label)

    with figure_to(path, 8.0, 4.2) as figure:
        figure.suptitle(title)
        left, right = figure.subplots(1, 2, sharey=True)
        _draw(left, [curve for curve in curves if curve.what == "lateness"], shades)
        _draw(right, [curve for curve in curves if curve.what == "exchange"], shades)
        left.set_ylim(0.6 * min(curve.share[-1] for curve in curves), 1.5)
        left.set_xlabel("wake-up latency above")
        right.set_xlabel("exchange takes longer than")
        left.set_ylabel("share of ticks")
        clocks = sorted({curve.clock for curve in curves if curve.clock})
        handles = [sample(shade, "-", frequency(rate)) for rate, shade in shades.items()]
        handles += [sample("0.4", style.CLOCKS[clock], f"clock: {clock}") for clock in clocks]
        handles.append(sample("0.4", ":", "a period of that rate"))
        legend_below(figure, len(handles), handles=handles, columnspacing=1.2)


def _draw(axes: Axes, curves: list[Survival], shades: dict[float, Any]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    for curve in curves:
        look = {"color": shades[curve.rate_hz], "linewidth": 1.3, "linestyle": style.CLOCKS[curve.clock]}
        axes.step(curve.time, curve.share, where="pre", **look)
    for rate in {curve.rate_hz for curve in curves}:
        axes.axvline(1.0 / rate, color=shades[rate], linewidth=0.9, linestyle=":", zorder=1.5)
    axes.xaxis.set_major_formatter(lambda t, _: short_duration(t))
    axes.yaxis.set_major_formatter(lambda share, _: f"{100.0 * share:.4g} %")
    axes.grid(which="major", color="0.88", linewidth=0.6)
