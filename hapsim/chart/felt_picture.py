"""The picture of what a hand feels: a plane for each correction; its share against the mass and against the delay."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart.felt import OF_SHARES, WITHIN, Felt, FeltChart, Outcome
from hapsim.chart.figure import figure_to

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WORDS = {
    Outcome.WITHIN_1: "within 1 %",
    Outcome.WITHIN_5: "5 %",
    Outcome.WITHIN_10: "10 %",
    Outcome.FURTHER_OFF: "further off",
    Outcome.OUT_OF_REACH: "out of reach",
    Outcome.UNSTABLE: "unstable",
    Outcome.NOT_ASKED: "the device has more by itself",
}
_COLOURS = ("#12355b", "#2f7f9e", "#9cc9c4", "#f3ead2", "#ffffff", "#c9c0b4", "#ffffff")
"""By Outcome: the better felt, the darker, in grey too."""
_HATCHES = {Outcome.OUT_OF_REACH: "//////", Outcome.UNSTABLE: "xxxxxx"}
_HATCH = "0.45"
_LINES: dict[str, Any] = {
    "none": {"color": "#b3541e", "linestyle": (0, (1.2, 1.2)), "marker": "v"},
    "poles": {"color": "#4c9a8b", "linestyle": (0, (5, 1.6)), "marker": "s"},
    "predictor": {"color": "#12355b", "linestyle": "-", "marker": "o"},
}
_POINT: Any = {"marker": "o", "markersize": 6, "markerfacecolor": "black", "markeredgecolor": "white", "zorder": 5}
_BOX: Any = {"facecolor": "white", "edgecolor": "none", "alpha": 0.88, "pad": 2.0}


def draw_felt(chart: FeltChart, title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    with figure_to(path, 7.4, 5.6) as figure:
        figure.suptitle(f"Is what is asked for what is felt?   {title}", fontsize=10)
        above, below = np.asarray(figure.subfigures(2, 1, height_ratios=[1.22, 1.0])).tolist()
        panels = above.subplots(1, len(chart.felt), sharex=True, sharey=True)
        for axes, (name, felt) in zip(panels, chart.felt.items(), strict=True):
            _draw_plane(axes, chart, name, felt)
        panels[0].set_ylabel("desired damping ratio")
        _legend_of_outcomes(above, chart)
        left, right = below.subplots(1, 2, sharey=True)
        _draw_shares(left, chart.mass_ratio, chart.against_mass, "true mass / declared mass")
        _draw_shares(right, chart.delay, chart.against_delay, "delay  (samples)")
        _tell_limit(right, chart.limit)
        left.set_xscale("log", base=2)
        left.set_xticks([0.5, 0.7, 1.0, 1.4, 2.0], ["0.5", "0.7", "1", "1.4", "2"])
        left.set_ylabel(f"share felt within {100.0 * OF_SHARES:.0f} %")
        handles, labels = left.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)


def _draw_plane(axes: Axes, chart: FeltChart, name: str, felt: Felt) -> None:
    from matplotlib.colors import ListedColormap

    kappa, ratio = _edges(np.log(chart.plane.kappa)), _edges(chart.plane.ratio)
    colours = ListedColormap(_COLOURS)
    x, y = np.exp(kappa), ratio
    limits: Any = {"vmin": -0.5, "vmax": len(_COLOURS) - 0.5}
    axes.pcolormesh(x, y, felt.outcome.T, cmap=colours, rasterized=True, linewidth=0, **limits)
    for outcome, hatch in _HATCHES.items():
        here = (felt.outcome == outcome).T.astype(float)
        if here.any() and min(here.shape) > 1:
            drawn = axes.contourf(
                chart.plane.kappa, chart.plane.ratio, here, levels=[0.5, 1.5], colors="none", hatches=[hatch]
            )
            drawn.set_edgecolor(_HATCH)
            drawn.set_linewidth(0.0)
    axes.set_xscale("log")
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(0.0, y[-1])
    axes.set_title(f"correction: {name}")
    axes.set_xlabel("desired $K\\,T^2/m$")
    shares = "\n".join(f"{100.0 * felt.share(within):.0f} % within {100.0 * within:.0f} %" for within in WITHIN)
    axes.text(0.965, 0.96, shares, transform=axes.transAxes, va="top", ha="right", fontsize=8.5, bbox=_BOX, zorder=6)
    point = chart.operating_point
    if point is not None and x[0] <= point[0] <= x[-1] and 0.0 <= point[1] <= y[-1]:
        axes.plot(*point, **_POINT)


def _edges(middles: Any) -> Any:
    half = 0.5 * (middles[1] - middles[0])
    return np.append(middles - half, middles[-1] + half)


def _legend_of_outcomes(figure: Any, chart: FeltChart) -> None:
    from matplotlib.patches import Patch

    shown = {int(outcome) for felt in chart.felt.values() for outcome in np.unique(felt.outcome)}
    handles = [
        Patch(
            facecolor=_COLOURS[outcome],
            edgecolor=_HATCH,
            linewidth=0.5,
            hatch=_HATCHES.get(outcome),
            label=words,
        )
        for outcome, words in _WORDS.items()
        if outcome in shown
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, columnspacing=1.1)


def _draw_shares(axes: Axes, x: Any, shares: dict[str, Any], label: str) -> None:
    for name, share in shares.items():
        axes.plot(x, 100.0 * share, label=name, markersize=3.8, linewidth=1.3, markevery=0.09, **_LINES[name])
    axes.set_xlabel(label)
    axes.set_xlim(x[0], x[-1])
    axes.set_ylim(0.0, 108.0)
    axes.yaxis.set_major_formatter(lambda value, _: f"{value:.0f} %")
    axes.grid(color="0.9", linewidth=0.6)
    axes.set_axisbelow(True)


def _tell_limit(axes: Axes, limit: float) -> None:
    axes.axhline(100.0 * limit, color="0.4", linewidth=0.8, zorder=0.9)
    words = f"any controller: {100.0 * limit:.0f} % at most,\nwhat swings below half the rate"
    axes.text(
        0.97, 100.0 * limit - 4.0, words, transform=axes.get_yaxis_transform(), va="top", ha="right", fontsize=8.5
    )
