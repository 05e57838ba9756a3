"""The force on a hand over its places in the plane, with the surfaces and paths that make it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from hapsim.chart import style
from hapsim.chart.figure import drawn_in, figure_to, legend_below, once
from hapsim.errors import UsageError
from hapsim.prediction.plane_geometry import Plane
from hapsim.scene import Scene
from hapsim.scene.chain import Point
from hapsim.scene.outlines import FAR, outlines_of
from hapsim.theory.arrays import Floats

_PLACES = 41  # along the longer side
_MARGIN = 0.15  # of what is drawn, on each side of it
_LEAST = 0.02  # m, of a side drawn
_WEAK = 1e-3  # of the strongest force drawn: less is no arrow


class ForceField(NamedTuple):
    """The numbers of the picture of one hand."""

    name: str
    area: Floats  # lower left and upper right corner, (2, 2) m
    x: Floats  # m, of each place
    y: Floats
    fx: Floats  # N, with which the scene pushes a hand that rests there
    fy: Floats

    @property
    def strength(self) -> Floats:
        """Size of the force, N."""
        return np.hypot(self.fx, self.fy)


def force_field(scene: Scene, name: str, corners: Sequence[Point] | None) -> ForceField:
    """Returns the force on the hand `name` over an area between two corners, m; None: about all that the scene has.
    Masses are where they start. Raises UsageError for an area without a size."""
    area = np.array(_about(scene) if corners is None else corners)
    low, high = area.min(axis=0), area.max(axis=0)
    if not (size := high - low).min() > 0.0:
        raise UsageError("--area: found an area without a size, expected two opposite corners")
    counts = np.maximum(np.round(_PLACES * size / size.max()), 2.0).astype(int)
    sides = [a + (np.arange(n) + 0.5) * one / n for a, n, one in zip(low, counts, size, strict=True)]
    x, y = (one.ravel() for one in np.meshgrid(*sides))
    return ForceField(name, np.array([low, high]), x, y, *Plane(scene).forces(x, y, name))


def _about(scene: Scene) -> Floats:
    """Returns the corners of an area about all that the scene has, and at least 2 cm wide."""
    at = Plane(scene).start
    seen = [*at.values()]
    for one in outlines_of(scene):
        near = [place for place in one.places if one.about and math.hypot(*place) < FAR]
        seen += [(x + at[one.about][0], y + at[one.about][1]) for x, y in near]
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    room = np.maximum(_MARGIN * np.max(high - low), 0.5 * (_LEAST - high + low))
    return np.array([low - room, high + room])


def columns_of(field: ForceField) -> dict[str, Floats]:
    """Returns what is drawn, by the names that a data file uses."""
    return {"x_m": field.x, "y_m": field.y, "force_x_N": field.fx, "force_y_N": field.fy}


def draw_field(field: ForceField, scene: Scene, path: Path) -> None:
    """Draws it to a file: .svg, .png or .pdf."""
    from matplotlib.colors import Normalize

    (left, low), (right, high) = field.area.tolist()
    width = 6.0 if right - left >= high - low else 6.0 * (right - left) / (high - low)
    with figure_to(path, width + 1.8, width * (high - low) / (right - left) + 1.4) as figure:
        axes, units = figure.add_subplot(), drawn_in()
        _draw_outlines(axes, scene, field.name)
        size, limit = field.strength, scene.device.force_limit
        limit = min(float(size.max(initial=0.0)), limit) or limit
        pushed = size > _WEAK * limit
        x, y, fx, fy, newtons = (one[pushed] for one in (field.x, field.y, field.fx, field.fy, size))
        spacing = (right - left) / len(np.unique(field.x))
        arrows = axes.quiver(
            *(units.scaled(one, "mm") for one in (x, y)),
            *(spacing * units.scaled(one / newtons, "mm") for one in (fx, fy)),
            units.scaled(newtons, "N"),
            norm=Normalize(0.0, units.scaled(limit, "N")),
            cmap=style.FELT_ERROR,
            **style.FIELD,
        )
        for name, (px, py) in Plane(scene).start.items():
            axes.plot(*units.scaled(np.array([[px], [py]]), "mm"), **style.PLACE)
            axes.annotate(name, units.scaled(np.array([px, py]), "mm"), **style.PLACE_NAME)
        axes.set_xlim(*units.scaled(np.array([left, right]), "mm"))
        axes.set_ylim(*units.scaled(np.array([low, high]), "mm"))
        axes.set_aspect("equal")
        axes.set_xlabel(f"x ({units.name('mm')})")
        axes.set_ylabel(f"y ({units.name('mm')})")
        axes.set_title(f"Force on {field.name} at rest", fontsize=9)
        beyond = "max" if size.max(initial=0.0) > limit else "neither"
        figure.colorbar(arrows, ax=axes, label=f"force ({units.name('N')})", extend=beyond)
        if axes.get_legend_handles_labels()[1]:
            legend_below(figure, 3)


def _draw_outlines(axes: Any, scene: Scene, hand: str) -> None:
    """Draws what the hand touches, what other points do, and the travel of the device."""
    from matplotlib.patches import PathPatch
    from matplotlib.path import Path as Curve

    scaled, labels = drawn_in().scaled, set[str]()
    at = Plane(scene).start | {"": (0.0, 0.0)}
    solid = {"outside", "inside"}
    together = groupby(outlines_of(scene), key=lambda one: (one.of, one.about, one.kind in solid or one.name))
    for (_, about, _), every in together:
        one, *others = every
        places = [scaled(np.array(each.places) + at[about], "mm") for each in (one, *others)]
        kind = one.kind if not one.of or hand in (one.of, one.about) else "of other points"
        if kind in style.OUTLINES:
            for each in places:
                axes.plot(*each.T, label=once(kind, labels), **style.OUTLINES[kind])
            continue
        curves = [Curve(each, closed=True) for each in places]
        if kind == "inside":
            around = scaled(FAR * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)]), "mm")
            curves.insert(0, Curve(around, closed=True))
        axes.add_patch(PathPatch(Curve.make_compound_path(*curves), label=once("shape", labels), **style.MATERIAL))
