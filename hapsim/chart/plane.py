"""The deformed parameter space: curves of equal k and of equal b in the K,B plane (Florens et al., Figures 7, 8, 9).

Of one mass, or of several over each other: a hand adds an unknown mass (§4 and §5).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hapsim.chart import plane_curves as curves
from hapsim.chart import style
from hapsim.chart.figure import figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.chart.plane_axes import Scale, View
from hapsim.chart.plane_curves import Curve, Sheet
from hapsim.errors import UsageError
from hapsim.number_format import short
from hapsim.theory.arrays import Bools, Floats

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MOST = (12, 9)  # curves of equal k, and of equal b
_MOST_OF_A_FAMILY = (4, 4)  # for each of several masses
_SHARES = {"iso_k": 0.6, "iso_b": 0.35}  # of a curve's length: where its number is
_SHORTEST = 30.0  # pixels of a curve that has a number
MOST_MASSES = len(style.OF_MASS)


@dataclass(frozen=True)
class Point:
    """An operating point: what is simulated for a hand, and what it feels; as drawn."""

    name: str
    mass: float
    """kg."""
    K: float
    B: float
    k: float
    b: float
    is_seen: bool


@dataclass(frozen=True)
class Plane:
    """The plane of one mass or several; every number in the axes' units."""

    sheets: tuple[Sheet, ...]
    """One for each mass."""
    iso: tuple[Curve, ...]
    """Curves of equal k and of equal b."""
    boundaries: tuple[Curve, ...]
    """b = 0, for each mass."""
    unstable: tuple[Curve, ...]
    """Outlines of where the loop is unstable with at least one of the masses."""
    points: tuple[Point, ...]
    ideal: tuple[Curve, ...] = ()
    """Where the curves would be in continuous time. This and what follows: of one mass only."""
    without_equivalent: tuple[Curve, ...] = ()
    """Outlines of where no spring and damper is felt, stable or not; empty if none of it is stable."""
    fold: tuple[Curve, ...] = ()
    linear: tuple[Curve, ...] = ()
    passive: tuple[Curve, ...] = ()
    """An outline; empty if the condition is not derived."""

    @property
    def is_family(self) -> bool:
        """Whether it shows several masses."""
        return len(self.sheets) > 1

    @property
    def scale(self) -> Scale:
        """The axes' units."""
        return self.sheets[0].scale

    def columns(self) -> dict[str, list[Any]]:
        """Returns what is drawn, by the names that a data file uses: a row for each point of a curve."""
        regions = (*self.unstable, *self.without_equivalent, *self.passive)
        columns = curves.joined((*self.iso, *self.ideal, *self.boundaries, *self.fold, *self.linear, *regions))
        for at in self.points:
            values = ("operating_point", math.nan, at.mass, at.K, at.B, at.k, at.b)
            for column, value in zip(columns.values(), values, strict=True):
                column.append(value)
        names = dict(zip(("K", "B", "k", "b"), self.scale.columns, strict=True))
        return {names.get(name, name): values for name, values in columns.items()}


def plane(hands: Sequence[Hand], view: View, scale: Scale) -> Plane:
    """Returns the plane of hands that differ in nothing but their mass, or of hands with one and the same
    configuration. Raises UsageError if there are more masses than can be distinguished."""
    configurations = list(dict.fromkeys(hand.configuration for hand in hands))
    if len(configurations) > MOST_MASSES:
        raise UsageError(f"--mass: found {len(configurations)} masses, expected at most {MOST_MASSES} in one picture")
    sheets = [Sheet(configuration, view, scale) for configuration in configurations]
    several = len(sheets) > 1
    # One set of values for all masses, so that a curve can be followed from mass to mass.
    values = curves.values_felt(sheets[len(sheets) // 2], *(_MOST_OF_A_FAMILY if several else _MOST))

    def is_unstable(K: Floats, B: Floats) -> Bools:
        return np.any([~configuration.is_stable(K, B) for configuration in configurations], axis=0)

    return Plane(
        sheets=tuple(sheets),
        iso=tuple(curve for sheet in sheets for curve in curves.iso_curves(sheet, *values)),
        boundaries=tuple(curves.stability_boundary(sheet) for sheet in sheets),
        unstable=tuple(sheets[0].region("unstable", is_unstable)),
        points=tuple(_operating_point(hand, view, scale) for hand in hands if hand.is_simulated),
        **({} if several else _of_one_mass(sheets[0], *values)),
    )


def _of_one_mass(sheet: Sheet, k_values: Floats, b_values: Floats) -> dict[str, tuple[Curve, ...]]:
    """Returns the curves that would hide each other if they were drawn for several masses."""
    configuration = sheet.configuration
    K, B = sheet.mesh(coarse=2)
    lost: list[Curve] = []
    if np.any(configuration.is_stable(K, B) & ~configuration.dominant(K, B)):
        # Worked out for the whole plane: its stable part may be narrower than a mesh. The unstable is drawn over it.
        lost = sheet.region("no_equivalent", lambda K, B: ~configuration.dominant(K, B))
    passive: tuple[Curve, ...] = ()
    with contextlib.suppress(ValueError):  # not derived for this configuration
        passive = (curves.passive(sheet),)
    return {
        "ideal": tuple(curves.ideal_curves(sheet, k_values, b_values)),
        "without_equivalent": tuple(lost),
        "fold": (curves.fold(sheet),),
        "linear": (curves.linear_limit(sheet),),
        "passive": passive,
    }


def _operating_point(hand: Hand, view: View, scale: Scale) -> Point:
    k, b = hand.felt()
    K, B = scale.of_stiffness(hand.stiffness), scale.of_simulated(hand.damping)
    seen = view.shows(hand.stiffness, hand.damping)
    return Point(hand.name, hand.configuration.mass, K, B, scale.of_stiffness(k), scale.of_damping(b), seen)


def draw_plane(data: Plane, title: str, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    with figure_to(path, 6.5, 5.9) as figure:
        axes = figure.add_subplot()
        axes.set_title(title)
        _set_axes(axes, data)
        unstable = "unstable with one of them at least" if data.is_family else "unstable"
        _fill(axes, data.unstable, unstable, style.UNSTABLE_WITH_SOME_MASS if data.is_family else style.UNSTABLE)
        _fill(axes, data.without_equivalent, "no spring and damper is equivalent", style.NO_EQUIVALENT)
        _fill(axes, data.passive, "passive: stable with any hand", style.PASSIVE)
        _draw_curves(axes, data)
        _draw_points(axes, data)
        legend_below(figure, 2, handlelength=3.2)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")  # numbers on curves leave gaps in them that fit this layout
        _draw_numbered(axes, data, _write_at_points(axes, data))


def _set_axes(axes: Axes, data: Plane) -> None:
    """Draws K horizontally and B vertically, as the paper does."""
    view, scale = data.sheets[0].view, data.scale
    axes.set_xlim(0.0, scale.of_stiffness(view.K_to))
    axes.set_ylim(scale.of_simulated(view.B_from), scale.of_simulated(view.B_to))
    axes.set_xlabel(scale.axis_labels[0])
    axes.set_ylabel(scale.axis_labels[1])
    if scale.total and scale.offset > 0.0:
        axes.annotate("– $B = 0$", (1.0, scale.of_simulated(0.0)), xycoords=("axes fraction", "data"), va="center")


def _fill(axes: Axes, outlines: Sequence[Curve], label: str, look: style.Look) -> None:
    """Fills a region without its holes; draws nothing if it is empty."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Outline

    rings = [np.column_stack([ring.K, ring.B]) for ring in outlines if ring.is_seen]
    if rings:
        closed = [Outline(np.vstack([ring, ring[:1]]), closed=True) for ring in rings]
        axes.add_patch(PathPatch(Outline.make_compound_path(*closed), label=label, **look))


def _looks(data: Plane) -> dict[float, style.Look]:
    """Returns the look of each mass's curves."""
    masses = [sheet.configuration.mass for sheet in data.sheets]
    return dict(zip(masses, style.OF_MASS, strict=False))


def _draw_curves(axes: Axes, data: Plane) -> None:
    for mass, boundary, look in zip(_looks(data), data.boundaries, _looks(data).values(), strict=True):
        label = f"$m$ = {mass:g} kg: stability boundary, $b = 0$" if data.is_family else "stability boundary, $b = 0$"
        if boundary.is_seen:
            axes.plot(boundary.K, boundary.B, label=label, **style.LIMIT, **look)
    for drawn, label, look in (
        (data.ideal, "where they would be in continuous time", style.IDEAL),
        (data.fold, "fold", style.FOLD),
        (data.linear, "rule for the origin, $K = (B + b_0)/$lag", style.LINEAR),
    ):
        for i, curve in enumerate(curve for curve in drawn if curve.is_seen):
            axes.plot(curve.K, curve.B, label="" if i else label, **look)
    if data.is_family:
        axes.plot([], [], label="thin: equal $k$ (N/m) and equal $b$ (N·s/m)", color="black", **style.ISO["iso_k"])
        return
    for kind, what, name in zip(style.ISO, ("stiffness", "damping"), data.scale.felt_names, strict=True):
        if any(curve.kind == kind and curve.is_seen for curve in data.iso):
            look = style.ISO[kind] | style.ISO_OF_ONE_MASS[kind]
            axes.plot([], [], label=f"equal felt {what}, {name}", **look)


def _draw_points(axes: Axes, data: Plane) -> None:
    """Marks the operating points; adds lines of words to the legend for what is not in the picture."""
    words = [f"outside: {_words([point], data)}" for point in data.points if not point.is_seen]
    if not data.is_family and not data.passive:
        words.append("passivity: no condition is derived")
    elif not data.is_family and not data.passive[0].is_seen:
        words.append("passive: nowhere, without real friction")
    for line in words:
        axes.plot([], [], " ", label=line)
    seen = [(point.K, point.B) for point in data.points if point.is_seen]
    if seen:
        axes.plot(*zip(*seen, strict=True), label="operating point", **style.OPERATING_POINT)


def _draw_numbered(axes: Axes, data: Plane, words: Sequence[Any]) -> None:
    """Draws the curves of equal k and b, each with its number in a gap, clear of the `words` that are there."""
    from matplotlib.contour import ContourSet
    from matplotlib.transforms import Bbox

    shown = [curve for curve in data.iso if curve.is_seen]
    if not shown:
        return
    looks = _looks(data)
    of_curve = [looks[one.mass] if data.is_family else style.ISO_OF_ONE_MASS[one.kind] for one in shown]
    drawn = ContourSet(
        axes,
        list(range(len(shown))),
        [_pieces(curve) for curve in shown],
        colors=[look["color"] for look in of_curve],
        linestyles=[look.get("linestyle", "-") for look in of_curve],
        linewidths=[style.ISO[one.kind]["linewidth"] for one in shown],
    )
    boxes = [text.get_window_extent().expanded(1.1, 1.3) for text in words]
    names = {"iso_k": "$k$ = ", "iso_b": "$b$ = "} if data.is_family else {"iso_k": "", "iso_b": ""}
    # Between the lightest and the heaviest mass the style of a curve says enough.
    first, last = data.sheets[0].configuration.mass, data.sheets[-1].configuration.mass
    for i, one in enumerate(shown):
        if one.mass in (first, last):
            share = _SHARES[one.kind] + (0.25 if one.mass != first else 0.0)
            place = _place_on(axes, _pieces(one), share, boxes)
            fmt = {i: f"{names[one.kind]}{short(one.value)}"}
            if place is not None:
                corners = np.add(axes.transData.transform(place), [[-26.0], [26.0]])  # pixels: two numbers end to end
                boxes.append(Bbox(corners))
                axes.clabel(drawn, levels=[i], fmt=fmt, manual=[place], fontsize=8.5, colors="black", inline_spacing=3)


def _place_on(axes: Axes, pieces: list[Any], share: float, boxes: Sequence[Any]) -> Any | None:
    """Returns the place for a number on the longest piece of a curve: near this share of its length, outside of
    `boxes`; None if the piece is short."""
    pixels = [axes.transData.transform(piece) for piece in pieces]
    inside = [line[[axes.bbox.contains(*point) for point in line]] for line in pixels]
    lengths = [np.append(0.0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))) for line in inside]
    longest = max(range(len(inside)), key=lambda i: float(lengths[i][-1]))
    line, length = inside[longest], lengths[longest]
    for offset in (0.0, 0.1, -0.1, 0.2, -0.2, 0.3):
        at = length[-1] * (share + offset)
        place = [float(np.interp(at, length, column)) for column in line.T] if length[-1] > _SHORTEST else None
        if place is not None and not any(box.contains(*place) for box in boxes):
            return axes.transData.inverted().transform(place)
    return None


def _pieces(curve: Curve) -> list[Any]:
    """Splits a line at its gaps."""
    points = np.column_stack([curve.K, curve.B])
    there = np.isfinite(points).all(axis=1)
    cuts = np.flatnonzero(np.diff(there)) + 1
    return [piece for piece in np.split(points, cuts) if np.isfinite(piece).all() and len(piece) > 1]


def _write_at_points(axes: Axes, data: Plane) -> list[Any]:
    """Writes what is felt beside each operating point; returns the texts."""
    groups: dict[tuple[str, float, float], list[Point]] = {}
    for point in data.points:
        if point.is_seen:
            groups.setdefault((point.name, point.K, point.B), []).append(point)
    texts = []
    for i, ((_, K, B), points) in enumerate(groups.items()):
        x, y = axes.transAxes.inverted().transform(axes.transData.transform((K, B)))
        right, up = x < 0.5, (1 if y < 0.75 else -1) * (18 + 34 * i)
        text = axes.annotate(
            _words(points, data),
            (K, B),
            (26 if right else -26, up),
            textcoords="offset points",
            ha="left" if right else "right",
            va="bottom" if up > 0 else "top",
            multialignment="left",
            arrowprops={"arrowstyle": "-", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3},
            bbox=style.WORDS_BOX,
            zorder=7,
        )
        texts.append(text)
    return texts


def _words(points: Sequence[Point], data: Plane) -> str:
    """Returns what is simulated, and what it feels like: of several masses a line each."""
    first = points[0]
    lines = [f"{first.name}: $K$ = {short(first.K)}, ${data.scale.simulated}$ = {short(first.B)}"]
    for at in points:
        felt = f"$k$ = {short(at.k)}, $b$ = {short(at.b)}" if math.isfinite(at.k) else "no spring and damper"
        lines.append(f"{at.mass:g} kg feels {felt}" if data.is_family else f"feels {felt}")
    return "\n".join(lines)
