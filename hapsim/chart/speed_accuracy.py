"""Cost of a simulated second over its error: a panel for each object, a line for each method."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.number_format import frequency
from hapsim.speed_accuracy.results import Object, Row, fronts

_ABREAST = 3
_LEAST_ERROR = 1e-13  # what is below is rounding, and drawn here
_PLAIN: style.Look = {"color": "0.2", "linestyle": "", "markersize": 4.0}
_QUANTITIES: dict[str, style.Look] = {
    "$k$": _PLAIN | {"marker": "o"},
    "$b$": _PLAIN | {"marker": "s", "markerfacecolor": "white"},
}


def draw_speed_accuracy(objects: Sequence[Object], rows: Sequence[Row], path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    across = min(len(objects), _ABREAST)
    down = math.ceil(len(objects) / across)
    ours, peers = looks_of(objects, rows)
    with figure_to(path, max(6.4, 3.45 * across), 3.0 * down + (1.1 if across > 1 else 1.6)) as figure:
        panels = figure.subplots(down, across, squeeze=False).ravel()
        for i, (axes, one) in enumerate(zip(panels, objects, strict=False)):
            _draw(axes, one, [row for row in rows if row.object == one.name], ours | peers)
            axes.set(ylabel="relative error" if i % across == 0 else "")
            axes.set(xlabel="processor time of a simulated second, s" if i + across >= len(objects) else "")
        for axes in panels[len(objects) :]:
            axes.set_axis_off()
        named = dict(ours)
        for name, dashes in style.PRECISIONS.items():
            named[f"{name} precision"] = {"color": "0.2", "linestyle": dashes, "linewidth": 1.1}
        named |= _QUANTITIES if any(len(one.quantities) > 1 for one in objects) else {}
        named |= {"front of hapsim's own": style.FRONT, "real time": style.REAL_TIME} | peers
        handles = [Line2D([], [], label=name, **look) for name, look in named.items()]
        legend_below(figure, 6 if len(objects) > 1 else 3, handles=handles, columnspacing=1.4, fontsize=8)


def looks_of(objects: Sequence[Object], rows: Sequence[Row]) -> tuple[dict[str, style.Look], dict[str, style.Look]]:
    """Returns the looks of hapsim's methods and those of the peers, the same in every panel."""
    methods = list(dict.fromkeys(method for one in reversed(objects) for method in one.methods))
    drawn = {row.method for row in rows if row.ours}
    ours = {
        method: style.METHOD | {"color": colour, "markerfacecolor": colour}
        for method, colour in zip(methods, itertools.cycle(style.METHODS), strict=False)
        if method in drawn
    }
    others = dict.fromkeys(row.whose for row in rows if not row.ours and row.good)
    peers = {
        peer: style.PEER | {"color": grey, "marker": marker}
        for peer, (grey, marker) in zip(others, itertools.cycle(style.PEERS), strict=False)
    }
    return ours, peers


def _draw(axes: Axes, one: Object, rows: Sequence[Row], looks: dict[str, style.Look]) -> None:
    axes.set(xscale="log", yscale="log", title=one.title)
    axes.axvline(1.0, **style.REAL_TIME)
    for front in fronts(rows).values():
        if front:
            axes.step([row.cost for row in front], [_error(row) for row in front], where="post", **style.FRONT)
    lines: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row.good:
            lines.setdefault((row.method if row.ours else row.whose, row.precision, row.quantity), []).append(row)
    for (name, precision, quantity), line in lines.items():
        look = dict(looks[name])
        if line[0].ours:
            look["linestyle"] = style.PRECISIONS.get(precision, "-")
            if quantity in one.quantities[1:]:  # the second quantity has hollow markers
                look |= {"marker": "s", "markerfacecolor": "white"}
        axes.plot([row.cost for row in line], [_error(row) for row in line], **look)
    _write_rates(axes, [line for line in lines.values() if line[0].ours])
    axes.margins(x=0.08, y=0.1)
    axes.grid()


def _write_rates(axes: Axes, lines: Sequence[Sequence[Row]]) -> None:
    """Writes the rates at the ends of two of the longest lines: above the highest and below the lowest."""
    longest = max(map(len, lines), default=0)
    whole = [line for line in lines if len(line) == longest]
    if not whole:
        return
    ends = [(max(whole, key=lambda line: line[0].off)[0], (3, 5))]
    if longest > 1:
        ends.append((min(whole, key=lambda line: line[-1].off)[-1], (0, -11)))
    for row, offset in ends:
        place: Any = {"xy": (row.cost, _error(row)), "xytext": offset, "textcoords": "offset points"}
        axes.annotate(frequency(row.rate_hz), **place, fontsize=8, color="0.25", zorder=4.0)


def _error(row: Row) -> float:
    return max(row.off, _LEAST_ERROR)
