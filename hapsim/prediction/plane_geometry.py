"""The links of a scene in the plane, wherever its points are: distance, direction, curvature and force of each.

This is the geometry of the scene alone, without the loop, so that pictures and measurements may use it. For small
motions a link of slope K and tension f is K n n' + (f/r) t t', with its normal n, its tangent t and a curvature 1/r.
Stuck friction adds its bristle along t. Friction that slides reads the pressure along n and pulls along t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np

from hapsim.prediction.characteristic import starts_at
from hapsim.prediction.reach import start_positions
from hapsim.scene import DevicePoint, Link, Scene
from hapsim.scene.chain import Nearest, Piece, Point, remembered_within
from hapsim.scene.modules.surfaces import Surface, surfaces_of
from hapsim.theory.arrays import Floats

_MOST_STEPS = 100
_AT_REST = 1e-15  # m, by which what is left of the force stretches the stiffest link
_HALVINGS, _BEYOND = 30, 0.9
_LEAST_STIFFNESS = 1e-6  # N/m, for a mass that no spring holds
_TOUCHED = 1e-300  # m, least depth in a wall of a corner
_LOOKS = 512  # places along a straight way
_PLACES = 16  # that are remembered of the ends of each link: most rest while one is moved along a surface
_NOWHERE = Nearest(math.inf, (1.0, 0.0), 0.0)


class PlaneLink(NamedTuple):
    """Link of the plane where its ends are. It pulls its first end by `tension` against the normal."""

    name: str
    link: Any
    distance: float
    """Distance of its law, m."""
    normal: Point
    """Unit vector along which the distance grows, for its first end."""
    curvature: float
    """Turn of the normal per metre across it, 1/m; infinite near the centre of a round, or where the ends of a link
    between points meet: there the normal is remembered, and does not turn."""
    piece: int
    """Piece of its chain; 0 without one."""
    tension: float
    """N, with friction at rest."""
    slope: float
    """N/m."""
    damping: float
    """N·s/m."""
    state: str
    on: Piece | None = None
    """Piece of its chain."""
    corner: Corner | None = None
    """The hollow corner in which the hand is, if this wall shares it with that of another shape."""

    @property
    def stretch(self) -> Point:
        """Motion that changes its distance by the unit, and that of no other wall of the corner."""
        return self.normal if self.corner is None else self.corner.stretch

    @property
    def tangent(self) -> Point:
        """Unit vector along a surface or a path, a quarter of a turn to the left of the normal."""
        return -self.normal[1], self.normal[0]

    @property
    def across(self) -> float:
        """Stiffness along the tangent, N/m. Where a normal is remembered, only what holds across itself has one."""
        if self.link.holds_across == "always":
            return self.slope
        if math.isfinite(self.curvature):
            return self.tension * self.curvature
        return self.slope if self.link.holds_across == "near" or not self.tension else 0.0

    @property
    def damping_across(self) -> float:
        """Damping along the tangent, N·s/m: by the same share as it is stiff there, where it damps along itself."""
        if self.link.holds_across == "always":
            return self.damping
        is_corner = self.on is not None and self.on.extent < math.pi
        damps = self.link.damps_along == "always" or (is_corner and self.link.damps_along == "corners")
        return self.damping * self.across / self.slope if damps and self.slope and 0.0 < self.across < math.inf else 0.0

    @property
    def acts(self) -> bool:
        """True if it has a force, a stiffness or a damping there."""
        return bool(self.tension or self.slope or self.damping)

    @property
    def rubs(self) -> bool:
        """True if it touches with dry friction along its surface; in a corner that of one wall acts."""
        is_first = self.corner is None or self.corner.first == self.name
        return is_first and self.link.bristle is not None and self.link.break_away > 0.0 and self.acts

    def rows(self, sliding: int = 0) -> Iterator[Row]:
        """Yields the rows of small motions. `sliding`: 0 while its friction sticks; 1 or -1: towards or against the
        tangent. Friction holds no force where it sticks."""
        n, t, m, d, corner = self.normal, self.tangent, self.stretch, self.normal, self.corner
        if corner is None:
            yield from (Row(n, n, self.slope, self.damping), Row(t, t, self.across, self.damping_across))
        else:
            n, t, d = corner.normal, (-corner.normal[1], corner.normal[0]), corner.damps
            yield from (Row(self.normal, m, self.slope, 0.0), Row(d, d, 0.0, self.damping))
        if self.rubs and not sliding:
            yield Row(t, t, *self.link.bristle)
        if sliding and corner is None:
            share = -sliding * self.link.friction_coefficient
            yield Row(t, n, share * self.slope, share * self.damping)
            yield Row(n, t, -share * self.across, 0.0)
        elif sliding and corner is not None:
            share, ahead = -sliding * corner.friction, _dot(self.normal, n)
            yield Row(t, m, share * self.slope * ahead, 0.0)
            yield Row(t, d, 0.0, share * self.damping * _dot(d, n))
            yield Row(t, t, -share * self.tension * _dot(self.normal, t) / corner.depth, 0.0)
            yield Row(n, t, share * self.tension * ahead / corner.depth, 0.0)


class Corner(NamedTuple):
    """A hollow corner that walls of two shapes share, as one of them has it. The way out has a part along the normal of
    each, which that wall answers. The second damps along its normal, the first across that.

    Attributes:
        first, friction: name of the first wall, whose friction acts, and its coefficient.
        normal, depth: unit vector from the hand to the corner, and the way out, m.
        stretch: motion that changes the wall's own part by the unit, and not the other's.
        damps: unit vector along which the wall damps.
    """

    first: str
    friction: float
    normal: Point
    depth: float
    stretch: Point
    damps: Point


class Row(NamedTuple):
    """Part of a link: a motion of its first end along `stretch` is answered by a force against `pull`."""

    pull: Point
    stretch: Point
    stiffness: float
    damping: float


class Plane:
    """The links of a scene in the plane, at any places of its points.

    Attributes:
        links: by name, with its law. surfaces: of its shapes.
        start: the places of its points at the start, m, by module.
        hands, masses: names of the modules.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene, self.units = scene, scene.units
        self.links = {name: (link, link.law()) for name, link in scene.plane_links.items()}
        self.surfaces = surfaces_of(scene.plane_links)
        self._rank = {name: i for i, name in enumerate(self.links)}
        self._apart = {name: self._link(name, _NOWHERE) for one in self.surfaces for name in one.shapes}
        others = {name: link for name, (link, _) in self.links.items() if name not in self._apart}
        chains = {name: one.chain() for name, one in others.items()}
        self._opposite = {name: _away if chain is None else chain.nearest for name, chain in chains.items()}
        looks: list[tuple[tuple[str, str], Callable[[float, float], list[PlaneLink]]]] = [
            *((link.between, partial(self._alone, name)) for name, link in others.items()),
            *((one.between, partial(self._faced, one)) for one in self.surfaces),
        ]
        self._looks = [(between, lru_cache(_PLACES)(look)) for between, look in looks]
        self.start = _start(scene)
        self.hands = tuple(name for name, one in scene.modules.items() if isinstance(one, DevicePoint))
        self.masses = tuple(name for name in self.start if f"{name}.x" in scene.masses)

    def in_the_way(self, hand: str, place: Point) -> str:
        """Returns a shape through which a straight way leads this hand from its start to a place; "" if none does."""
        way = np.linspace(self.start[hand], place, _LOOKS)
        for surface in (one for one in self.surfaces if one.between[0] == hand):
            (chain, owners), names, entered = surface.outline, [*surface.shapes], None
            for x, y in (way - self.start[surface.between[1]]).tolist():
                here = chain.nearest(x, y)
                entered = (entered or here.normal) if here.distance < 0.0 else None
                if entered is not None and np.dot(entered, here.normal) < 0.0:
                    return names[owners[here.piece]]
        return ""

    def at(self, places: Mapping[str, Point]) -> list[PlaneLink]:
        """Returns every link with its ends at `places`, by default where they start, m."""
        every = self._apart | {one.name: one for one in self.near(places)}
        return [every[name] for name in self.links]

    def near(self, places: Mapping[str, Point]) -> list[PlaneLink]:
        """Returns the same, of a surface only the shapes that its point faces: no law of another one matters there."""
        at, found = {**self.start, **places}, list[PlaneLink]()
        for (first, second), look in self._looks:
            (ax, ay), (bx, by) = at[first], at[second]
            found += look(ax - bx, ay - by)
        return sorted(found, key=lambda one: self._rank[one.name])

    def _alone(self, name: str, x: float, y: float) -> list[PlaneLink]:
        """Returns a link that is no shape with its first end at (x, y) from its second."""
        return [self._link(name, self._opposite[name](x, y))]

    def _link(self, name: str, nearest: Nearest, on: Piece | None = None, corner: Corner | None = None) -> PlaneLink:
        """Returns a link as the nearest place of its chain has it."""
        (d, normal, curvature, piece), (link, law) = nearest, self.links[name]
        is_near = d <= remembered_within(law.rest) if on is None else on.radius + d <= remembered_within(on.radius)
        if curvature > 0.0 and is_near and (on is not None or self._opposite.get(name) is _away):
            curvature = math.inf
        is_apart = law.pushes and d >= law.knots[-1][0]
        tension = 0.0 if is_apart else float(law.tension(d))
        law_there = law.slope(d), law.damping(d), law.state(d)
        return PlaneLink(name, link, d, normal, curvature, piece, tension, *law_there, on, corner)

    def _faced(self, surface: Surface, x: float, y: float) -> list[PlaneLink]:
        """Returns the shapes of a surface that a point at (x, y) faces: the one on whose surface its place is, or in a
        hollow corner the two that meet there."""
        (chain, owners), names = surface.outline, [*surface.shapes]
        nearest = chain.nearest(x, y)
        on = chain.pieces[nearest.piece]
        both = owners[nearest.piece], surface.sharers[nearest.piece]
        if not nearest.distance < 0.0 or both[0] == both[1]:
            return [self._link(names[both[0]], nearest, on)]
        c, s = math.cos(on.extent), math.sin(on.extent)
        normals = np.array([(-on.ex, -on.ey), (-c * on.ex - s * on.ey, s * on.ex - c * on.ey)])
        stretches, way = np.linalg.inv(normals.T), -nearest.distance * np.array(nearest.normal)
        damps = np.array([(-normals[1, 1], normals[1, 0]), normals[1]])
        first, friction = names[both[0]], surface.shapes[names[both[0]]].friction_coefficient
        found = []
        for i, part in enumerate((stretches @ way).tolist()):
            n, m, d = (_point(one[i]) for one in (normals, stretches, damps))
            corner = Corner(first, friction, nearest.normal, -nearest.distance, m, d)
            found.append(self._link(names[both[i]], Nearest(-max(part, _TOUCHED), n, 0.0, nearest.piece), on, corner))
        return found

    def pieces(self, name: str) -> tuple[Piece, ...] | None:
        """Returns the pieces of what a shape or a guide is touched on; None for another link."""
        link, _ = self.links[name]
        for surface in self.surfaces:
            if name in surface.shapes:
                own = [*surface.shapes].index(name)
                (pieces,), owners = surface.outline
                return tuple(piece for piece, owner in zip(pieces, owners, strict=True) if owner == own)
        return None if (chain := link.chain()) is None else chain.pieces

    def forces(self, x: Floats, y: Floats, hand: str = "") -> tuple[Floats, Floats]:
        """Returns the static force, N, on a hand [default: the first] at each of these places, m: arrays of one shape.
        Other hands and masses are where they start, and friction has no force."""
        hand = hand or self.hands[0]
        force = np.zeros((np.size(x), 2))
        for i, place in enumerate(zip(np.ravel(x).tolist(), np.ravel(y).tolist(), strict=True)):
            for one in self.at({hand: place}):
                if hand in one.link.between:
                    side = 1.0 if one.link.between[0] == hand else -1.0
                    force[i] -= side * one.tension * np.array(one.normal)
        return force[:, 0].reshape(np.shape(x)), force[:, 1].reshape(np.shape(x))

    def at_rest(self, places: Mapping[str, Point]) -> dict[str, Point] | None:
        """Returns the places of all points with the masses at rest and the hands at `places`, by Newton's steps down
        the energy, each halved until it does not go far beyond the rest; None if no rest is found."""
        at, column = {**self.start, **places}, {name: 2 * i for i, name in enumerate(self.masses)}
        x = np.array([at[name] for name in self.masses]).ravel()

        def forces(x: Floats) -> tuple[Floats, Floats]:
            """Returns the forces (2 M,) on the masses, and their stiffness matrix."""
            force, K = np.zeros(x.size), np.zeros((x.size, x.size))
            for one in self.at(at | _places(self.masses, x)):
                n, t, m = (as_row(one.link, each, column, x.size) for each in (one.normal, one.tangent, one.stretch))
                force -= one.tension * n
                K += 0.5 * one.slope * (np.outer(n, m) + np.outer(m, n)) + one.across * np.outer(t, t)
            return force, K

        for _ in range(_MOST_STEPS if x.size else 0):
            force, K = forces(x)
            values, vectors = np.linalg.eigh(K)  # where one is negative, the rest is the other way
            values = np.maximum(np.abs(values), _LEAST_STIFFNESS)
            if np.abs(force).max() <= _AT_REST * values.max():
                break
            step = vectors @ (vectors.T @ force / values)
            for _ in range(_HALVINGS):
                if forces(x + step)[0] @ step >= -_BEYOND * force @ step:
                    break
                step = 0.5 * step
            x = x + step
        else:
            return None if x.size else at
        return at | _places(self.masses, x)


def as_row(link: Link, direction: Point, column: Mapping[str, int], size: int) -> Floats:
    """Returns the row (size,) of a direction at a link's ends. `column`: of the x of each point that moves."""
    row = np.zeros(size)
    for end, sign in zip(link.between, (1.0, -1.0), strict=True):
        if end in column:
            row[column[end] : column[end] + 2] += sign * np.array(direction)
    return row


def _places(names: Sequence[str], x: Floats) -> dict[str, Point]:
    return {name: (px, py) for name, (px, py) in zip(names, x.reshape(-1, 2).tolist(), strict=True)}


def _start(scene: Scene) -> dict[str, Point]:
    """Returns the places of all points at the start, m; of a hand at a port position 0."""
    hands = {name: starts_at(scene, one.channel) or 0.0 for name, one in scene.device_points.items()}
    at, points = start_positions(scene) | hands, (name for name, one in scene.modules.items() if one.is_point)
    return {name: (at[f"{name}.x"], at[f"{name}.y"]) for name in points}


def _dot(a: Point, b: Point) -> float:
    return a[0] * b[0] + a[1] * b[1]


def _point(values: Floats) -> Point:
    return float(values[0]), float(values[1])


def _away(x: float, y: float) -> Nearest:
    d = math.hypot(x, y)
    return Nearest(d, (x / d, y / d), 1.0 / d) if d else Nearest(0.0, (1.0, 0.0), math.inf)
