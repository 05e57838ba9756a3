"""The picture of an examination: which share of wake-ups and exchanges takes longer than a time, rate by rate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from hapsim.chart.figure import figure_to
from hapsim.doctor import words
from hapsim.theory.arrays import Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from hapsim.doctor.examine import Examination
    from hapsim.loop.histogram import Histogram

_LIGHTEST = 0.82  # of the colour map, from dark to light, so that print tells the rates apart too
_STYLES: dict[str, Any] = {"": "-", "device": "-", "host": (0, (4, 1.5))}


@dataclass(frozen=True)
class Survival:
    """Which share of something took longer than a time: its survival curve."""

    what: Literal["lateness", "exchange"]
    rate_hz: float
    clock: str
    """"" for wake-ups without a loop."""
    time: Floats
    """s, (n,), rising."""
    share: Floats
    """0 to 1: what took longer than every time from the one before up to that."""


def steadiness(examination: Examination) -> list[Survival]:
    """The curves of an examination: the lateness of bare wake-ups, and the exchanges' times."""
    curves = [_survival("lateness", rate, "", histogram) for rate, histogram in examination.wakeups.items()]
    curves += [
        _survival("exchange", run.rate_hz, run.clock, run.exchange)
        for run in examination.exchanges
        if run.exchange is not None
    ]
    return [curve for curve in curves if curve.time.size]


def columns(curves: list[Survival]) -> dict[str, list[Any]]:
    """What is drawn, by the names that a data file uses: a row a point."""
    points = [(curve, t, s) for curve in curves for t, s in zip(curve.time, curve.share, strict=True)]
    return {
        "what": [curve.what for curve, _, _ in points],
        "clock": [curve.clock for curve, _, _ in points],
        "rate_Hz": [curve.rate_hz for curve, _, _ in points],
        "longer_than_s": [float(t) for _, t, _ in points],
        "share": [float(s) for _, _, s in points],
    }


def draw_steadiness(curves: list[Survival], title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    shades = _shades(sorted({curve.rate_hz for curve in curves}))
    with figure_to(path, 8.0, 4.2) as figure:
        figure.suptitle(title, fontsize=10)
        left, right = figure.subplots(1, 2, sharey=True)
        _draw(left, [curve for curve in curves if curve.what == "lateness"], shades)
        _draw(right, [curve for curve in curves if curve.what == "exchange"], shades)
        left.set_ylim(0.6 * min(curve.share[-1] for curve in curves), 1.5)
        left.set_xlabel("wake-up latency above")
        right.set_xlabel("exchange takes longer than")
        left.set_ylabel("share of ticks")
        handles = [_sample(shade, "-", words.rate(rate)) for rate, shade in shades.items()]
        handles += [
            _sample("0.4", _STYLES[clock], f"clock: {clock}")
            for clock in sorted({curve.clock for curve in curves if curve.clock})
        ]
        handles.append(_sample("0.4", ":", "a period of that rate"))
        figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, columnspacing=1.2)


def _survival(what: Literal["lateness", "exchange"], rate: float, clock: str, histogram: Histogram) -> Survival:
    """Read at the end of every bin that holds something, so that no time is given too short; what took no time at all
    has no place on a logarithmic axis and is left out."""
    filled = np.flatnonzero(histogram.counts[1:]) + 1
    if filled.size == 0:
        return Survival(what, rate, clock, np.empty(0), np.empty(0))
    at_least = histogram.counts[::-1].cumsum()[::-1] / histogram.total
    ends = np.minimum(histogram.edges[filled + 1], histogram.maximum)
    time = np.concatenate([[min(histogram.edges[filled[0]], histogram.maximum)], ends])
    return Survival(what, rate, clock, time, np.concatenate([[at_least[filled[0]]], at_least[filled]]))


def _shades(rates: list[float]) -> dict[float, Any]:
    import matplotlib as mpl

    places = np.linspace(0.0, _LIGHTEST, len(rates))
    return dict(zip(rates, mpl.colormaps["inferno"](places), strict=True))


def _draw(axes: Axes, curves: list[Survival], shades: dict[float, Any]) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    for curve in curves:
        style = {"color": shades[curve.rate_hz], "linewidth": 1.3, "linestyle": _STYLES[curve.clock]}
        axes.step(curve.time, curve.share, where="pre", **style)
    for rate in {curve.rate_hz for curve in curves}:
        axes.axvline(1.0 / rate, color=shades[rate], linewidth=0.9, linestyle=":", zorder=1.5)
    axes.xaxis.set_major_formatter(lambda t, _: words.duration(t))
    axes.yaxis.set_major_formatter(lambda share, _: f"{100.0 * share:.4g} %")
    axes.grid(which="major", color="0.88", linewidth=0.6)


def _sample(color: Any, style: Any, label: str) -> Any:
    """A line for the legend, which is of more lines than it has names."""
    from matplotlib.lines import Line2D

    return Line2D([], [], color=color, linestyle=style, linewidth=1.3, label=label)
