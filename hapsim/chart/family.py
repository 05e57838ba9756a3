"""The K,B plane for a family of masses: the hand adds one that nobody knows (Florens et al., §4 and §5)."""

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
from hapsim.chart.plane import Point, fill, operating_point, set_axes
from hapsim.chart.round_numbers import short
from hapsim.chart.scale import Scale
from hapsim.chart.view import View
from hapsim.errors import UsageError
from hapsim.theory.arrays import Bools, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FEW = 4  # curves of equal k, and of equal b, at most
MOST_MASSES = len(looks.OF_MASS)


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
    k_values, b_values = curves.values_felt(sheets[len(sheets) // 2], _FEW, _FEW)
    members = [
        Member(
            sheet,
            curves.stability_limit(sheet),
            tuple([curves.iso_k(sheet, k) for k in k_values] + [curves.iso_b(sheet, b) for b in b_values]),
            operating_point(hand, view, scale) if hand.is_simulated else None,
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
        fill(axes, data.unstable, "unstable with one of them at least", looks.UNSTABLE_WITH_SOME_MASS)
        _draw_curves(axes, data)
        figure.legend(loc="outside lower center", ncols=2, frameon=False, handlelength=3.2, columnspacing=1.5)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        _write(axes, data)


def _draw_curves(axes: Axes, data: Family) -> None:
    for member, look in zip(data.members, looks.OF_MASS, strict=False):
        label = f"$m$ = {member.mass:g} kg: stability limit, $b = 0$"
        axes.plot(member.limit.K, member.limit.B, label=label, **looks.LIMIT_OF_MASS, **look)
        for curve in member.iso:
            axes.plot(curve.K, curve.B, **looks.ISO_OF_MASS[curve.kind], **look)
    axes.plot([], [], label="thin: equal $k$ (N/m) and equal $b$ (N·s/m)", **looks.ISO_IN_LEGEND)
    point = data.members[0].point
    if point is not None and point.is_seen:
        axes.plot([point.K], [point.B], label="operating point", **looks.OPERATING_POINT)


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
