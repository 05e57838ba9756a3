"""The deformed parameter space: curves of equal k and of equal b in the K,B plane (Florens et al., Figures 7, 8, 9).

For one mass, or for a family of masses: a hand adds an unknown mass (§4 and §5).
"""

from __future__ import annotations

import contextlib
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Bbox

from hapsim.chart import plane_curves as curves
from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below
from hapsim.chart.hand import Hand
from hapsim.chart.plane_curves import Curve, Scale, Sheet, View
from hapsim.errors import UsageError
from hapsim.number_format import short
from hapsim.theory.arrays import Bools, Floats
from hapsim.units import Units

_MOST = (12, 9)  # curves of equal k, and of equal b
_MOST_OF_A_FAMILY = (4, 4)  # for each of several masses
_SHARES = {"iso_k": 0.6, "iso_b": 0.35}  # of a curve's length: where its number is
_SHORTEST = 30.0  # pixels of a curve that has a number
_CLEAR = 4.0  # pixels around a number
MOST_MASSES = len(style.OF_MASS)


@dataclass(frozen=True)
class Point:
    """An operating point: what is simulated for a hand, and what it feels; as drawn."""

    name: str
    mass: float  # kg
    K: float
    B: float
    k: float
    b: float
    is_seen: bool


@dataclass(frozen=True)
class Plane:
    """The plane of one mass or several; every number in the axes' units."""

    sheets: tuple[Sheet, ...]  # one for each mass
    iso: tuple[Curve, ...]  # curves of equal k and of equal b
    boundaries: tuple[Curve, ...]  # b = 0, for each mass
    unstable: tuple[Curve, ...]
    """Outlines of where the loop is unstable with at least one of the masses."""
    points: tuple[Point, ...]
    ideal: tuple[Curve, ...] = ()
    """The same curves in continuous time. This and the following belong to a single mass."""
    without_equivalent: tuple[Curve, ...] = ()
    """Outlines of where no spring and damper is felt, stable or not; empty if none of it is stable."""
    fold: tuple[Curve, ...] = ()
    linear: tuple[Curve, ...] = ()
    passive: tuple[Curve, ...] = ()  # an outline; empty if the condition is not derived

    @property
    def masses(self) -> list[float]:
        """kg, one for each sheet."""
        return [sheet.configuration.mass for sheet in self.sheets]

    @property
    def is_family(self) -> bool:
        """True if it shows several masses."""
        return len(self.sheets) > 1

    @property
    def scale(self) -> Scale:
        """The axes' units."""
        return self.sheets[0].scale

    def shown_in(self, units: Units) -> Plane:
        """Returns the same in these units, for a picture."""
        k, b = self.scale.in_units(units)
        scale = replace(self.scale, stiffness=self.scale.stiffness / k, damping=self.scale.damping / b)
        changed: dict[str, Any] = {"sheets": tuple(replace(one, scale=scale) for one in self.sheets)}
        changed["points"] = tuple(replace(at, K=at.K * k, B=at.B * b, k=at.k * k, b=at.b * b) for at in self.points)
        for field in fields(self):
            if field.name not in changed:
                curves: tuple[Curve, ...] = getattr(self, field.name)
                changed[field.name] = tuple(
                    replace(one, value=one.value * (b if one.kind == "iso_b" else k), K=one.K * k, B=one.B * b)
                    for one in curves
                )
        return replace(self, **changed)

    def columns(self) -> dict[str, list[Any]]:
        """Returns what is drawn, by the names that a data file uses: a row for each point of a curve."""
        regions = (*self.unstable, *self.without_equivalent, *self.passive)
        drawn = (*self.iso, *self.ideal, *self.boundaries, *self.fold, *self.linear, *regions)
        rows = [row for curve in drawn if curve.is_seen for row in curve.rows()]
        rows += [("operating_point", math.nan, at.mass, at.K, at.B, at.k, at.b) for at in self.points]
        names = ("curve", "value", "mass_kg", *self.scale.columns)
        return {name: [row[i] for row in rows] for i, name in enumerate(names)}


def plane(hands: Sequence[Hand], view: View, scale: Scale) -> Plane:
    """Returns the plane of hands that differ in nothing but their mass, or of hands with one and the same
    configuration. Raises UsageError if there are more masses than can be distinguished."""
    configurations = list(dict.fromkeys(hand.configuration for hand in hands))
    if len(configurations) > MOST_MASSES:
        raise UsageError(f"--mass: found {len(configurations)} masses, expected at most {MOST_MASSES} in one picture")
    sheets = [Sheet(configuration, view, scale) for configuration in configurations]
    several = len(sheets) > 1
    # One set of values for all masses, so that a curve can be followed from mass to mass.
    values = curves.values_felt(sheets[len(sheets) // 2], *(_MOST_OF_A_FAMILY if several else _MOST), hands[0].units)

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
        # For the whole plane: its stable part may be narrower than a mesh. The unstable part is drawn over it.
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
    data = data.shown_in(drawn_in())
    with figure_to(path, 6.5, 5.9) as figure:
        axes = figure.add_subplot()
        axes.set_title(title)
        view, scale = data.sheets[0].view, data.scale  # K horizontally, as in the paper
        axes.set(xlim=(0.0, scale.of_stiffness(view.K_to)), xlabel=scale.axis_labels[0])
        axes.set(ylim=(scale.of_simulated(view.B_from), scale.of_simulated(view.B_to)), ylabel=scale.axis_labels[1])
        if scale.total and scale.offset > 0.0:
            where: Any = {"xycoords": ("axes fraction", "data"), "va": "center"}
            axes.annotate("– $B = 0$", (1.0, scale.of_simulated(0.0)), **where)
        unstable = "unstable for at least one mass" if data.is_family else "unstable"
        _fill(axes, data.unstable, unstable, style.UNSTABLE_WITH_SOME_MASS if data.is_family else style.UNSTABLE)
        _fill(axes, data.without_equivalent, "no spring and damper is equivalent", style.NO_EQUIVALENT)
        _fill(axes, data.passive, "passive: stable with any hand", style.PASSIVE)
        _draw_curves(axes, data)
        _draw_points(axes, data)
        legend_below(figure, 2, handlelength=3.2)
        figure.draw_without_rendering()  # from here on it is known where texts are
        _write_numbers(axes, data, _write_at_points(axes, data))


def _fill(axes: Axes, outlines: Sequence[Curve], label: str, look: style.Look) -> None:
    """Fills a region without its holes; draws nothing if it is empty."""
    rings = [np.column_stack([ring.K, ring.B]) for ring in outlines if ring.is_seen]
    if rings:
        closed = [Outline(np.vstack([ring, ring[:1]]), closed=True) for ring in rings]
        axes.add_patch(PathPatch(Outline.make_compound_path(*closed), label=label, **look))


def _draw_curves(axes: Axes, data: Plane) -> None:
    for curve in data.iso:
        of_mass = style.OF_MASS[data.masses.index(curve.mass)] if data.is_family else style.ISO_OF_ONE_MASS[curve.kind]
        axes.plot(curve.K, curve.B, **style.ISO[curve.kind] | of_mass)
    for mass, boundary, look in zip(data.masses, data.boundaries, style.OF_MASS, strict=False):
        whose = f"$m$ = {drawn_in()(mass, 'kg', 'g')}: " if data.is_family else ""
        if boundary.is_seen:
            axes.plot(boundary.K, boundary.B, label=f"{whose}stability boundary, $b = 0$", **style.LIMIT | look)
    for drawn, label, look in (
        (data.ideal, "where they would be in continuous time", style.IDEAL),
        (data.fold, "fold", style.FOLD),
        (data.linear, "rule for the origin, $K = (B + b_0)/$lag", style.LINEAR),
    ):
        for i, curve in enumerate(curve for curve in drawn if curve.is_seen):
            axes.plot(curve.K, curve.B, label="" if i else label, **look)
    if data.is_family:
        k, b = drawn_in().name("N/m"), drawn_in().name("N·s/m")
        axes.plot([], [], label=f"thin: equal $k$ ({k}) and equal $b$ ({b})", color="black", **style.ISO["iso_k"])
        return
    for kind, what, name in zip(style.ISO, ("stiffness", "damping"), data.scale.felt_names, strict=True):
        if any(curve.kind == kind and curve.is_seen for curve in data.iso):
            axes.plot([], [], label=f"equal felt {what}, {name}", **style.ISO[kind] | style.ISO_OF_ONE_MASS[kind])


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


def _write_at_points(axes: Axes, data: Plane) -> list[Any]:
    """Writes what is felt beside each operating point; returns the texts."""
    seen = [point for point in data.points if point.is_seen]
    texts = []
    for i, ((_, K, B), points) in enumerate(itertools.groupby(seen, lambda point: (point.name, point.K, point.B))):
        x, y = axes.transAxes.inverted().transform(axes.transData.transform((K, B)))
        right, up = x < 0.5, (1 if y < 0.75 else -1) * (18 + 34 * i)
        text = axes.annotate(
            _words(list(points), data),
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
    """Returns what is simulated, and what it feels like: with several masses a line each."""
    first = points[0]
    lines = [f"{first.name}: $K$ = {short(first.K)}, ${data.scale.simulated}$ = {short(first.B)}"]
    for at in points:
        felt = f"$k$ = {short(at.k)}, $b$ = {short(at.b)}" if math.isfinite(at.k) else "no spring and damper"
        lines.append(f"{drawn_in()(at.mass, 'kg', 'g')} feels {felt}" if data.is_family else f"feels {felt}")
    return "\n".join(lines)


def _write_numbers(axes: Axes, data: Plane, words: Sequence[Any]) -> None:
    """Writes the value on each curve of equal k or b, clear of the `words` and of each other."""
    taken = [text.get_window_extent().expanded(1.1, 1.3) for text in words]
    names = {"iso_k": "$k$ = ", "iso_b": "$b$ = "} if data.is_family else {"iso_k": "", "iso_b": ""}
    # Between the lightest and the heaviest mass the style of a curve says enough.
    first, last = data.masses[0], data.masses[-1]
    for curve in (curve for curve in data.iso if curve.mass in (first, last)):
        share = _SHARES[curve.kind] + (0.25 if curve.mass != first else 0.0)
        number = axes.text(0.0, 0.0, f"{names[curve.kind]}{short(curve.value)}", **style.NUMBER)
        box = _box_on(axes, curve, share, 0.5 * np.array(number.get_window_extent().size) + _CLEAR, taken)
        if box is None:
            number.remove()
        else:
            taken.append(box)
            x, y = axes.transData.inverted().transform(np.mean(box.get_points(), axis=0))
            number.set_position((x, y))


def _box_on(axes: Axes, curve: Curve, share: float, half: Floats, taken: Sequence[Any]) -> Bbox | None:
    """Returns a box for a number, in pixels, on the longest visible piece of a curve: near this share of its length,
    within the axes, clear of the boxes `taken`. `half`: half its size. None if there is no room."""
    points = axes.transData.transform(np.column_stack([curve.K, curve.B]))
    inside = np.array([np.isfinite(point).all() and axes.bbox.contains(*point) for point in points])
    ends = np.flatnonzero(np.diff(inside, prepend=False, append=False)).reshape(-1, 2)
    pieces = [points[begin:end] for begin, end in ends]
    lengths = [np.append(0.0, np.cumsum(np.hypot(*np.diff(piece, axis=0).T))) for piece in pieces]
    length, i = max(((along[-1], i) for i, along in enumerate(lengths)), default=(0.0, 0))
    if length < _SHORTEST:
        return None
    for offset in (0.0, 0.1, -0.1, 0.2, -0.2, 0.3):
        place = np.array([np.interp(length * (share + offset), lengths[i], column) for column in pieces[i].T])
        box = Bbox([place - half, place + half])
        is_inside = np.all(box.min >= axes.bbox.min) and np.all(box.max <= axes.bbox.max)
        if is_inside and not box.count_overlaps(taken):
            return box
    return None
