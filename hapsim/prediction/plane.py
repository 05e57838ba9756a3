"""The links of a scene in the plane, wherever its points are: distance, direction, curvature and force of each.

This is the geometry of the scene alone, without the loop, so that pictures and measurements may use it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from hapsim.prediction.characteristic import starts_at
from hapsim.prediction.reach import start_positions
from hapsim.scene import DevicePoint, Link, Scene
from hapsim.scene.chain import Nearest, Point
from hapsim.scene.modules.plane_links import Guide, Shape
from hapsim.theory.arrays import Floats


class PlaneLink(NamedTuple):
    """Link of the plane where its ends are. It pulls its first end by `tension` against the normal."""

    name: str
    link: Link
    distance: float
    """Of its law, m."""
    normal: Point
    """Unit vector along which the distance grows, for its first end."""
    curvature: float
    """Turn of the normal per metre across it, 1/m; infinite where the ends of a link between points meet."""
    piece: int
    """Piece of its chain; 0 without one."""
    tension: float
    """N, with friction at rest."""
    slope: float
    """N/m."""
    damping: float
    """N·s/m."""
    state: str

    @property
    def tangent(self) -> Point:
        """Unit vector along a surface or a path, a quarter of a turn to the left of the normal."""
        return -self.normal[1], self.normal[0]

    @property
    def across(self) -> float:
        """Stiffness along the tangent, N/m: that of a link without a length, where its ends meet, is its slope."""
        if math.isfinite(self.curvature):
            return self.tension * self.curvature
        return 0.0 if self.tension else self.slope

    @property
    def acts(self) -> bool:
        """True if it has a force, a stiffness or a damping there."""
        return bool(self.tension or self.slope or self.damping)


class Plane:
    """The links of a scene in the plane, at any places of its points.

    Attributes:
        start: the places of its points at the start, m, by module.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._links = {name: (link, link.law(), _opposite(link)) for name, link in scene.plane_links.items()}
        self.start = _start(scene)

    def at(self, places: Mapping[str, Point]) -> list[PlaneLink]:
        """Returns every link with its ends at `places`, by default where they start, m."""
        found, at = [], {**self.start, **places}
        for name, (link, law, opposite) in self._links.items():
            (ax, ay), (bx, by) = (at[end] for end in link.between)
            d, normal, curvature, piece = opposite(ax - bx, ay - by)
            tension = float(law.tension(d))
            found.append(
                PlaneLink(name, link, d, normal, curvature, piece, tension, law.slope(d), law.damping(d), law.state(d))
            )
        return found

    def forces(self, x: Floats, y: Floats, hand: str = "") -> tuple[Floats, Floats]:
        """Returns the static force, N, on a hand [default: the first] at each of these places, m: arrays of one shape.
        Other hands and masses are where they start, and friction has no force."""
        hand = hand or next(name for name, one in self.scene.modules.items() if isinstance(one, DevicePoint))
        fx, fy = np.zeros(np.shape(x)), np.zeros(np.shape(x))
        for link, law, opposite in self._links.values():
            if hand not in link.between:
                continue
            side = 1.0 if link.between[0] == hand else -1.0
            ox, oy = self.start[link.between[side > 0.0]]
            towards = zip(np.ravel(side * (x - ox)).tolist(), np.ravel(side * (y - oy)).tolist(), strict=True)
            each = [opposite(*one) for one in towards]
            nx, ny = np.array([one.normal for one in each]).reshape(-1, 2).T.reshape(2, *np.shape(x))
            pull = side * law.tension(np.array([one.distance for one in each])).reshape(np.shape(x))
            fx, fy = fx - pull * nx, fy - pull * ny
        return fx, fy


def _start(scene: Scene) -> dict[str, Point]:
    """Returns the places of all points at the start, m; of a hand at a port position 0."""
    hands = {name: starts_at(scene, one.channel) or 0.0 for name, one in scene.device_points.items()}
    at, points = start_positions(scene) | hands, (name for name, one in scene.modules.items() if one.is_point)
    return {name: (at[f"{name}.x"], at[f"{name}.y"]) for name in points}


def _opposite(link: Link) -> Callable[[float, float], Nearest]:
    """Returns the function from the first end minus the second, m, to the nearest place of the link."""
    return link.chain().nearest if isinstance(link, Shape | Guide) else _away


def _away(x: float, y: float) -> Nearest:
    d = math.hypot(x, y)
    return Nearest(d, (x / d, y / d), 1.0 / d) if d else Nearest(0.0, (1.0, 0.0), math.inf)
