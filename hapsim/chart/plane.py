"""The deformed parameter space: curves of equal k and of equal b in the K,B plane (Florens et al., Figures 7, 8, 9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart import curves
from hapsim.chart import plane_looks as looks
from hapsim.chart.curves import Curve, Sheet
from hapsim.chart.figure import figure_to
from hapsim.chart.hand import Hand
from hapsim.chart.labels import Labels
from hapsim.chart.round_numbers import short
from hapsim.chart.scale import Scale
from hapsim.chart.view import View

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST_K, _MOST_B = 12, 9  # curves of each family


@dataclass(frozen=True)
class Point:
    """An operating point: what is simulated for a hand, and what it feels; as drawn."""

    name: str
    K: float
    B: float
    k: float
    b: float
    is_seen: bool


@dataclass(frozen=True)
class Plane:
    """One configuration's plane; every number as drawn, in the units that `scale` names."""

    sheet: Sheet
    iso: tuple[Curve, ...]
    """Curves of equal k and of equal b."""
    ideal: tuple[Curve, ...]
    """Where these would be if nothing were lost."""
    limit: Curve
    """b = 0."""
    unstable: tuple[Curve, ...]
    """Outlines."""
    without_equivalent: tuple[Curve, ...]
    """Outlines: no spring and damper is felt, stable or not; empty where none of it is stable."""
    fold: Curve
    linear: Curve
    passive: Curve | None
    """Outline; None where the condition is not derived."""
    points: tuple[Point, ...]

    @property
    def scale(self) -> Scale:
        """The axes' units."""
        return self.sheet.scale

    def columns(self) -> dict[str, list[Any]]:
        """What is drawn, by the names that a data file uses: a row a point of a curve."""
        passive = () if self.passive is None else (self.passive,)
        regions = (*self.unstable, *self.without_equivalent, *passive)
        columns = curves.joined([*self.iso, *self.ideal, self.limit, self.fold, self.linear, *regions])
        for point in self.points:
            values = ("operating_point", math.nan, self.sheet.configuration.mass, point.K, point.B, point.k, point.b)
            for column, value in zip(columns.values(), values, strict=True):
                column.append(value)
        return curves.renamed(columns, self.scale)


def plane(hands: Sequence[Hand], view: View, scale: Scale) -> Plane:
    """The plane of the first hand, with the operating points of those that share its configuration."""
    configuration = hands[0].configuration
    sheet = Sheet(configuration, view, scale)
    k_values, b_values = curves.values_felt(sheet, _MOST_K, _MOST_B)
    try:
        passive = curves.passive(sheet)
    except ValueError:
        passive = None
    return Plane(
        sheet=sheet,
        iso=tuple([curves.iso_k(sheet, k) for k in k_values] + [curves.iso_b(sheet, b) for b in b_values]),
        ideal=tuple([curves.ideal_k(sheet, k) for k in k_values] + [curves.ideal_b(sheet, b) for b in b_values]),
        limit=curves.stability_limit(sheet),
        unstable=tuple(sheet.region("unstable", lambda K, B: ~configuration.is_stable(K, B))),
        without_equivalent=tuple(
            # In all of the plane, for what is stable of it may be narrower than a mesh; the unstable is drawn over it.
            sheet.region("no_equivalent", lambda K, B: ~configuration.dominant(K, B)) if _is_lost(sheet) else ()
        ),
        fold=curves.fold(sheet),
        linear=curves.linear_limit(sheet),
        passive=passive,
        points=tuple(
            operating_point(hand, view, scale)
            for hand in hands
            if hand.is_simulated and hand.configuration == configuration
        ),
    )


def _is_lost(sheet: Sheet) -> bool:
    K, B = sheet.mesh(coarse=2)
    return bool(np.any(sheet.configuration.is_stable(K, B) & ~sheet.configuration.dominant(K, B)))


def operating_point(hand: Hand, view: View, scale: Scale) -> Point:
    """What a hand with a simulated K and B feels, as drawn."""
    k, b = hand.felt()
    K, B = scale.of_stiffness(hand.stiffness), scale.of_simulated(hand.damping)
    return Point(hand.name, K, B, scale.of_stiffness(k), scale.of_damping(b), view.shows(hand.stiffness, hand.damping))


def draw_plane(data: Plane, title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    with figure_to(path, 6.5, 5.9) as figure:
        axes = figure.add_subplot()
        axes.set_title(title)
        set_axes(axes, data.sheet)
        _draw_regions(axes, data)
        _draw_curves(axes, data)
        figure.legend(loc="outside lower center", ncols=2, frameon=False, handlelength=2.6, columnspacing=1.5)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        _write(axes, data)


def set_axes(axes: Axes, sheet: Sheet) -> None:
    """K horizontally, B vertically, as in the paper."""
    view, scale = sheet.view, sheet.scale
    axes.set_xlim(0.0, scale.of_stiffness(view.K_to))
    axes.set_ylim(scale.of_simulated(view.B_from), scale.of_simulated(view.B_to))
    axes.set_xlabel(scale.stiffness_axis)
    axes.set_ylabel(scale.damping_axis)
    if scale.total and scale.offset > 0.0:
        axes.annotate(" $B = 0$", (1.0, scale.of_simulated(0.0)), xycoords=("axes fraction", "data"), va="center")
        axes.plot(
            [0.99, 1.0],
            2 * [scale.of_simulated(0.0)],
            transform=axes.get_yaxis_transform(),
            **looks.ZERO_MARK,
        )


def fill(axes: Axes, outlines: Sequence[Curve], label: str, look: looks.Look) -> None:
    """Fills a region, holes left out; nothing where it is empty."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [_closed(Outline, ring) for ring in outlines if ring.is_seen]
    if rings:
        axes.add_patch(PathPatch(Outline.make_compound_path(*rings), label=label, **look))


def _closed(make: Any, ring: Curve) -> Any:
    corners = list(zip(ring.K, ring.B, strict=True))
    return make([*corners, corners[0]], closed=True)


def _draw_regions(axes: Axes, data: Plane) -> None:
    fill(axes, data.unstable, "unstable", looks.UNSTABLE)
    fill(axes, data.without_equivalent, "no spring and damper is equivalent", looks.NO_EQUIVALENT)
    if data.passive is not None and data.passive.is_seen:
        fill(axes, [data.passive], "passive: no hand whatever makes it unstable", looks.PASSIVE)


def _draw_curves(axes: Axes, data: Plane) -> None:
    scale = data.scale
    for i, curve in enumerate(data.ideal):
        label = "" if i else "where they would be if nothing were lost"
        axes.plot(curve.K, curve.B, label=label, **looks.IDEAL)
    names = {"iso_k": f"equal felt stiffness, {scale.k_name}", "iso_b": f"equal felt damping, {scale.b_name}"}
    for curve in data.iso:
        label, named = names[curve.kind], axes.get_legend_handles_labels()[1]
        axes.plot(curve.K, curve.B, label="" if label in named else label, **looks.ISO[curve.kind])
    if data.limit.is_seen:
        axes.plot(data.limit.K, data.limit.B, label="stability limit, $b = 0$", **looks.LIMIT)
    if data.fold.is_seen:
        axes.plot(data.fold.K, data.fold.B, label="fold", **looks.FOLD)
    if data.linear.is_seen:
        label = "rule for the origin, $K = (B + b_0)/$lag"
        axes.plot(data.linear.K, data.linear.B, label=label, **looks.LINEAR)
    seen = [point for point in data.points if point.is_seen]
    if seen:
        K, B = [point.K for point in seen], [point.B for point in seen]
        axes.plot(K, B, label="operating point", **looks.OPERATING_POINT)
    for point in data.points:
        if not point.is_seen:
            axes.plot([], [], " ", label=f"outside: {_words(point, scale)}")
    if data.passive is None:
        axes.plot([], [], " ", label="passivity: no condition is derived")
    elif not data.passive.is_seen:
        axes.plot([], [], " ", label="passive: nowhere, without real friction")


def _write(axes: Axes, data: Plane) -> None:
    """The numbers on the curves, and what is felt beside each operating point."""
    lines = [*data.iso, *3 * [data.limit], data.fold, data.linear]
    labels = Labels(axes, [(curve.K, curve.B) for curve in lines])
    for point in data.points:
        if point.is_seen:
            labels.beside(point.K, point.B, _words(point, data.scale), fontsize=9)
    for curve in data.iso:
        labels.along(curve.K, curve.B, short(curve.value), fontsize=9)


def _words(point: Point, scale: Scale) -> str:
    simulated = f"{point.name}: $K$ = {short(point.K)}, ${scale.simulated}$ = {short(point.B)}"
    if math.isfinite(point.k):
        return f"{simulated}\nfeels $k$ = {short(point.k)}, $b$ = {short(point.b)}"
    return f"{simulated}\nno spring and damper is equivalent"
