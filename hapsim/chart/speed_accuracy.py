"""The picture of a comparison: what a simulated second costs against how far it is off, a panel an object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hapsim.chart.figure import figure_to
from hapsim.doctor import words
from hapsim.speed_accuracy.results import Object, Row, fronts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ABREAST = 3
_LEAST_ERROR = 1e-13  # nothing is drawn below: there it is rounding
_COLOURS = ("#1f3b73", "#d95f0e", "#1b8a5a", "#b0307c", "#e6a817", "#5aa7d6", "#7f4f24", "#777777")
_GREYS = ("0.35", "0.50", "0.62", "0.42", "0.56", "0.68", "0.47", "0.60", "0.72")
_PEER_MARKERS = ("v", "^", "<", ">", "P", "X", "*", "p", "h", "8")
_LINES = {"double": "-", "single": (0, (3.0, 1.6))}
_SECOND = 1  # the quantity whose markers are hollow
_FRONT: Any = {"color": "#f6cf65", "linewidth": 4.5, "alpha": 0.75, "solid_joinstyle": "round", "zorder": 1.2}
_REAL_TIME: Any = {"color": "0.2", "linewidth": 0.9, "linestyle": ":", "zorder": 1.0}
_Group = tuple[str, str, str]


def draw_speed_accuracy(objects: Sequence[Object], rows: Sequence[Row], path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    across = min(len(objects), _ABREAST)
    down = math.ceil(len(objects) / across)
    with figure_to(path, max(6.4, 3.45 * across), 3.0 * down + (1.1 if across > 1 else 1.6)) as figure:
        panels = figure.subplots(down, across, squeeze=False).ravel()
        styles = _Styles(objects, rows)
        for axes, one in zip(panels, objects, strict=False):
            _draw(axes, one, [row for row in rows if row.object == one.name], styles)
        for axes in panels[len(objects) :]:
            axes.set_axis_off()
        for i, axes in enumerate(panels[: len(objects)]):
            axes.set_ylabel("relative error" if i % across == 0 else "")
            axes.set_xlabel("processor time of a simulated second, s" if i + across >= len(objects) else "")
        _legend(figure, objects, styles)


class _Styles:
    """Colours of hapsim's methods, greys and markers of the peers, the same in every panel."""

    def __init__(self, objects: Sequence[Object], rows: Sequence[Row]) -> None:
        methods = list(dict.fromkeys(method for one in reversed(objects) for method in one.methods()))
        drawn = {row.method for row in rows if row.ours}
        self.colours = {m: _COLOURS[i % len(_COLOURS)] for i, m in enumerate(methods) if m in drawn}
        peers = list(dict.fromkeys(row.whose for row in rows if not row.ours and row.good))
        self.peers = {
            peer: (_GREYS[i % len(_GREYS)], _PEER_MARKERS[i % len(_PEER_MARKERS)]) for i, peer in enumerate(peers)
        }


def _draw(axes: Axes, one: Object, rows: Sequence[Row], styles: _Styles) -> None:
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_title(one.title)
    axes.axvline(1.0, **_REAL_TIME)
    for front in fronts(rows).values():
        if front:
            _draw_front(axes, front)
    groups: dict[_Group, list[Row]] = {}
    for row in rows:
        if row.good:
            groups.setdefault((row.whose if not row.ours else row.method, row.precision, row.quantity), []).append(row)
    for (name, precision, quantity), members in groups.items():
        hollow = one.quantities.index(quantity) == _SECOND if quantity in one.quantities else False
        style = _of_method(styles, name, precision, hollow) if members[0].ours else _of_peer(styles, name)
        axes.plot([row.cost for row in members], [_drawn(row) for row in members], **style)
    _tell_rates(axes, [members for members in groups.values() if members[0].ours])
    axes.margins(x=0.08, y=0.1)
    axes.grid(which="major", color="0.9", linewidth=0.6, zorder=0.0)
    axes.set_axisbelow(True)


def _tell_rates(axes: Axes, lines: Sequence[Sequence[Row]]) -> None:
    """At the ends of lines with as many points as there are: above the highest, and below the lowest; in between all
    go the same way."""
    most = max(map(len, lines), default=0)
    whole = [line for line in lines if len(line) == most]
    if not whole:
        return
    first, last = max(whole, key=lambda line: line[0].off)[0], min(whole, key=lambda line: line[-1].off)[-1]
    for row, beside in ((first, (3, 5)), (last, (0, -11))) if most > 1 else ((first, (3, 5)),):
        place: Any = {"xy": (row.cost, _drawn(row)), "xytext": beside, "textcoords": "offset points"}
        axes.annotate(words.rate(row.rate_hz), **place, fontsize=8, color="0.25", zorder=4.0)


def _draw_front(axes: Axes, front: Sequence[Row]) -> None:
    costs, errors = [row.cost for row in front], [_drawn(row) for row in front]
    axes.step([*costs], [*errors], where="post", **_FRONT)


def _drawn(row: Row) -> float:
    return max(row.off, _LEAST_ERROR)


def _of_method(styles: _Styles, name: str, precision: str, hollow: bool) -> dict[str, Any]:
    colour = styles.colours[name]
    return {
        "color": colour,
        "linestyle": _LINES.get(precision, "-"),
        "linewidth": 1.1,
        "marker": "s" if hollow else "o",
        "markersize": 3.6,
        "markerfacecolor": "white" if hollow else colour,
        "markeredgewidth": 0.9,
        "zorder": 3.0,
    }


def _of_peer(styles: _Styles, name: str) -> dict[str, Any]:
    grey, marker = styles.peers[name]
    return {
        "color": grey,
        "linestyle": "-",
        "linewidth": 0.6,
        "marker": marker,
        "markersize": 3.8,
        "markerfacecolor": "white",
        "markeredgewidth": 0.7,
        "zorder": 2.0,
    }


def _legend(figure: Figure, objects: Sequence[Object], styles: _Styles) -> None:
    from matplotlib.lines import Line2D

    def line(label: str, **style: Any) -> Line2D:
        return Line2D([], [], label=label, **style)

    handles = [line(name, **_of_method(styles, name, "double", hollow=False)) for name in styles.colours]
    handles += [line(f"{name} precision", color="0.2", linestyle=_LINES[name], linewidth=1.1) for name in _LINES]
    if any(len(one.quantities) > 1 for one in objects):
        plain: Any = {"color": "0.2", "linestyle": "", "markersize": 4.0}
        handles += [
            line("$k$", marker="o", **plain),
            line("$b$", marker="s", markerfacecolor="white", **plain),
        ]
    handles.append(line("front of hapsim's own", **_FRONT))
    handles.append(line("real time", **_REAL_TIME))
    handles += [line(name, **_of_peer(styles, name)) for name in styles.peers]
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=6 if len(objects) > 1 else 3,
        frameon=False,
        columnspacing=1.4,
        fontsize=8,
    )
