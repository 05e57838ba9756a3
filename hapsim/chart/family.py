"""The K,B plane for a family of masses: the hand adds one that nobody knows (Florens et al., §4 and §5)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart import curves
from hapsim.chart.curves import Curve, Sheet
from hapsim.chart.figure import figure_to
from hapsim.chart.hand import Hand
from hapsim.chart.labels import Labels
from hapsim.chart.plane import DOT, Point, fill, operating_point, set_axes
from hapsim.chart.round_numbers import short
from hapsim.chart.scale import Scale
from hapsim.chart.view import View
from hapsim.errors import UsageError
from hapsim.theory.arrays import Bools, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FEW = 4  # curves of equal k, and of equal b, at most
_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": "black"},
    {"color": "0.35", "dashes": (6, 2)},
    {"color": "0.5", "dashes": (1.5, 1.5)},
    {"color": "0.2", "dashes": (6, 2, 1.5, 2)},
    {"color": "0.6", "dashes": (10, 3)},
)
MOST_MASSES = len(_LOOKS)


@dataclass(frozen=True)
class Member:
    """One mass of the family; curves as drawn."""

    sheet: Sheet
    limit: Curve
    iso: tuple[Curve, ...]
    point: Point | None

    @property
    def mass(self) -> float:
        """kg."""
        return self.sheet.configuration.mass


@dataclass(frozen=True)
class Family:
    """The planes of several masses, one over the other."""

    members: tuple[Member, ...]
    unstable: tuple[Curve, ...]
    """Outlines of where at least one of them is unstable."""

    @property
    def scale(self) -> Scale:
        """The axes' units."""
        return self.members[0].sheet.scale

    def columns(self) -> dict[str, list[Any]]:
        """What is drawn, by the names that a data file uses: a row a point of a curve."""
        drawn = [curve for member in self.members for curve in (*member.iso, member.limit)]
        columns = curves.joined([*drawn, *self.unstable])
        for member in self.members:
            if member.point is not None:
                at = member.point
                values = ("operating_point", math.nan, member.mass, at.K, at.B, at.k, at.b)
                for column, value in zip(columns.values(), values, strict=True):
                    column.append(value)
        return curves.renamed(columns, self.scale)


def family(hands: Sequence[Hand], view: View, scale: Scale) -> Family:
    """Hands that differ in their mass only. UsageError where they are more than can be distinguished in grey."""
    if len(hands) > MOST_MASSES:
        raise UsageError(f"--mass: found {len(hands)} masses, expected at most {MOST_MASSES} in one picture")
    sheets = [Sheet(hand.configuration, view, scale) for hand in hands]
    # One set of values for all, so that a curve can be followed from mass to mass.
    k_values, b_values = curves.values_met(sheets[len(sheets) // 2], _FEW, _FEW)
    members = [
        Member(
            sheet,
            curves.stability_limit(sheet),
            tuple([curves.iso_k(sheet, k) for k in k_values] + [curves.iso_b(sheet, b) for b in b_values]),
            operating_point(hand, view, scale) if hand.is_written else None,
        )
        for sheet, hand in zip(sheets, hands, strict=True)
    ]

    def some_unstable(K: Floats, B: Floats) -> Bools:
        return np.any([~hand.configuration.is_stable(K, B) for hand in hands], axis=0)

    return Family(tuple(members), tuple(sheets[0].region("unstable", some_unstable)))


def draw_family(data: Family, title: str, path: Path) -> None:
    """Draws it. The ending of `path` chooses SVG, PNG or PDF."""
    with figure_to(path, 6.5, 5.9) as figure:
        axes = figure.add_subplot()
        axes.set_title(title)
        set_axes(axes, data.members[0].sheet)
        fill(axes, data.unstable, "unstable with one of them at least", facecolor="0.92", linewidth=0, zorder=0.5)
        _draw_curves(axes, data)
        figure.legend(loc="outside lower center", ncols=2, frameon=False, handlelength=3.2, columnspacing=1.5)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        _write(axes, data)


def _draw_curves(axes: Axes, data: Family) -> None:
    for member, look in zip(data.members, _LOOKS, strict=False):
        label = f"$m$ = {member.mass:g} kg: stability limit, $b = 0$"
        axes.plot(member.limit.K, member.limit.B, linewidth=2.4, label=label, zorder=3, **look)
        for curve in member.iso:
            axes.plot(curve.K, curve.B, linewidth=1.0 if curve.kind == "iso_k" else 0.7, zorder=2, **look)
    axes.plot([], [], color="black", linewidth=1.0, label="thin: equal $k$ (N/m) and equal $b$ (N·s/m)")
    point = data.members[0].point
    if point is not None and point.is_seen:
        axes.plot([point.K], [point.B], "o", label="operating point", **DOT)


def _write(axes: Axes, data: Family) -> None:
    lines: list[Curve] = []
    for member in data.members:
        lines += [*member.iso, *3 * [member.limit]]  # that is covered last
    labels = Labels(axes, [(curve.K, curve.B) for curve in lines])
    point = data.members[0].point
    if point is not None and point.is_seen:
        labels.beside(point.K, point.B, _words(data), fontsize=9)
    # Between the lightest and the heaviest the style of a curve says enough.
    for member in {id(member): member for member in (data.members[0], data.members[-1])}.values():
        for curve in member.iso:
            name = "k" if curve.kind == "iso_k" else "b"
            labels.along(curve.K, curve.B, f"${name}$ = {short(curve.value)}", fontsize=9)


def _words(data: Family) -> str:
    lines: list[str] = []
    for member in data.members:
        at = member.point
        if at is None:
            continue
        if not lines:
            lines.append(f"{at.name}: $K$ = {short(at.K)}, ${data.scale.simulated}$ = {short(at.B)} feels")
        felt = f"$k$ = {short(at.k)}, $b$ = {short(at.b)}" if math.isfinite(at.k) else "no spring and damper"
        lines.append(f"{member.mass:g} kg: {felt}")
    return "\n".join(lines)
