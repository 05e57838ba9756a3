"""The links of a scene in the plane, wherever its points are: distance, direction, curvature and force of each.

This is the geometry of the scene alone, without the loop, so that pictures and measurements may use it. For small
motions a link of slope K and tension f is K n n' + (f/r) t t', with its normal n, its tangent t and a curvature 1/r.
Stuck friction adds its bristle along t. Friction that slides reads the pressure along n and pulls along t.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.prediction.characteristic import starts_at
from hapsim.prediction.reach import start_positions
from hapsim.scene import DevicePoint, Friction, Link, Scene, Spring, ViscoElastic
from hapsim.scene.chain import NEAR, NEAR_SHARE, Nearest, Point
from hapsim.scene.modules.surfaces import Guide, Shape
from hapsim.theory.arrays import Floats

_MOST_STEPS = 100
_AT_REST = 1e-15  # m, by which what is left of the force stretches the stiffest link
_HALVINGS, _BEYOND = 30, 0.9
_LEAST_STIFFNESS = 1e-6  # N/m, for a mass that no spring holds
_PARALLEL, _OUTSIDE = 1e-9, 1e-12  # sine of an angle that is none, and m


class PlaneLink(NamedTuple):
    """Link of the plane where its ends are. It pulls its first end by `tension` against the normal."""

    name: str
    link: Link
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
    along: Point | None = None
    """Motion that changes its distance by itself, by the unit: the normal unless it shares a corner with another."""

    @property
    def tangent(self) -> Point:
        """Unit vector along a surface or a path, a quarter of a turn to the left of the normal."""
        return -self.normal[1], self.normal[0]

    @property
    def across(self) -> float:
        """Stiffness along the tangent, N/m. Where a normal is remembered, only a spring has one."""
        if math.isfinite(self.curvature):
            return self.tension * self.curvature
        return self.slope if isinstance(self.link, Spring | ViscoElastic) or not self.tension else 0.0

    @property
    def damping_across(self) -> float:
        """Damping along the tangent, N·s/m: a hollow corner of a shape, and a guide outside a bend or beyond its end,
        damp along themselves by the same share as they are stiff."""
        if not isinstance(self.link, Shape | Guide) or not self.slope or not 0.0 < self.across < math.inf:
            return 0.0
        is_corner = self.link.chain().pieces[self.piece].extent < math.pi
        return self.damping * self.across / self.slope if is_corner or isinstance(self.link, Guide) else 0.0

    @property
    def acts(self) -> bool:
        """True if it has a force, a stiffness or a damping there."""
        return bool(self.tension or self.slope or self.damping)

    @property
    def rubs(self) -> bool:
        """True if it touches with dry friction along its surface."""
        return isinstance(self.link, Shape) and self.link.break_away > 0.0 and self.acts

    def rows(self, sliding: int = 0) -> Iterator[Row]:
        """Yields the rows of small motions. `sliding`: 0 while its friction sticks; 1 or -1: towards or against the
        tangent. Friction holds no force where it sticks."""
        n, t = self.normal, self.tangent
        if isinstance(self.link, Friction):
            yield from (Row(axis, axis, self.slope, self.damping) for axis in ((1.0, 0.0), (0.0, 1.0)))
            return
        if self.along is None:
            yield Row(n, n, self.slope, self.damping)
        else:
            yield from (Row(n, self.along, self.slope, 0.0), Row(n, n, 0.0, self.damping))
        yield Row(t, t, self.across, self.damping_across)
        if self.rubs and isinstance(self.link, Shape):
            if not sliding:
                yield Row(t, t, *self.link.bristle)
            else:
                share = -sliding * self.link.friction_coefficient
                yield Row(t, n, share * self.slope, share * self.damping)
                yield Row(n, t, -share * self.across, 0.0)


class Row(NamedTuple):
    """Part of a link: a motion of its first end along `stretch` is answered by a force against `pull`."""

    pull: Point
    stretch: Point
    stiffness: float
    damping: float


class Plane:
    """The links of a scene in the plane, at any places of its points.

    Attributes:
        links: by name, with its law and the function from its stretch to the nearest place of it.
        start: the places of its points at the start, m, by module.
        hands, masses: names of the modules.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.links = {name: (link, link.law(), _opposite(link)) for name, link in scene.plane_links.items()}
        self.start = _start(scene)
        self.hands = tuple(name for name, one in scene.modules.items() if isinstance(one, DevicePoint))
        self.masses = tuple(name for name in self.start if f"{name}.x" in scene.masses)

    def at(self, places: Mapping[str, Point]) -> list[PlaneLink]:
        """Returns every link with its ends at `places`, by default where they start, m."""
        found, at = list[PlaneLink](), {**self.start, **places}
        together: dict[tuple[str, str], list[int]] = {}
        for name, (link, law, opposite) in self.links.items():
            (ax, ay), (bx, by) = (at[end] for end in link.between)
            d, normal, curvature, piece = opposite(ax - bx, ay - by)
            if curvature > 0.0 and _remembers(link, d, piece):
                curvature = math.inf
            is_apart = law.pushes and d >= law.knots[-1][0]
            tension = 0.0 if is_apart else float(law.tension(d))
            if isinstance(link, Shape):
                together.setdefault(link.between, []).append(len(found))
            found.append(
                PlaneLink(name, link, d, normal, curvature, piece, tension, law.slope(d), law.damping(d), law.state(d))
            )
        for own in together.values():
            (ax, ay), (bx, by) = (at[end] for end in found[own[0]].link.between)
            for i, shared in zip(own, self._shared([found[i] for i in own], ax - bx, ay - by), strict=True):
                found[i] = shared
        return found

    def _shared(self, shapes: list[PlaneLink], x: float, y: float) -> list[PlaneLink]:
        """Returns shapes that one point at (x, y) may touch as they share its way out: the shortest that leaves them
        all. One of them leads out alone, or two to the corner where they meet; the others have no force."""
        touched = [i for i, one in enumerate(shapes) if one.distance < 0.0]
        if not touched or len(shapes) == 1:
            return shapes
        for i in sorted(touched, key=lambda i: shapes[i].distance):
            (nx, ny), d = shapes[i].normal, shapes[i].distance
            out = x - d * nx, y - d * ny
            there = [self.links[one.name][2](*out) for one in shapes]
            inside = [j for j, one in enumerate(there) if one.distance < -_OUTSIDE and j != i]
            if not inside:
                return _led_out(shapes, {i: -d}, {})
            for j in inside:
                N = np.array([(nx, ny), there[j].normal])
                if abs(np.linalg.det(N)) < _PARALLEL:
                    continue
                deep = np.linalg.solve(N @ N.T, [-d, -there[j].distance - d * float(N[0] @ N[1])])
                if (deep >= 0.0).all():
                    along = dict(zip((i, j), np.linalg.solve(N @ N.T, N).tolist(), strict=True))
                    both = [
                        one._replace(normal=there[j].normal, piece=there[j].piece) if k == j else one
                        for k, one in enumerate(shapes)
                    ]
                    return _led_out(both, dict(zip((i, j), deep.tolist(), strict=True)), along)
        return shapes

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
                n, t = (as_row(one.link, each, column, x.size) for each in (one.normal, one.tangent))
                force -= one.tension * n
                K += one.slope * np.outer(n, n) + one.across * np.outer(t, t)
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


def _led_out(
    shapes: list[PlaneLink], deep: Mapping[int, float], along: Mapping[int, Sequence[float]]
) -> list[PlaneLink]:
    """Returns shapes of which these, by number, share the way out: m each, and the motion that changes it."""
    found = []
    for i, one in enumerate(shapes):
        if i in deep:
            law = one.link.law()
            tension, slope = float(law.tension(-deep[i])), law.slope(-deep[i])
            damping, state = law.damping(-deep[i]), law.state(-deep[i])
            motion = (along[i][0], along[i][1]) if along else None
            found.append(one._replace(tension=tension, slope=slope, damping=damping, state=state, along=motion))
        elif one.distance < 0.0:
            found.append(one._replace(tension=0.0, slope=0.0, damping=0.0, state="behind another"))
        else:
            found.append(one)
    return found


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


def _opposite(link: Link) -> Callable[[float, float], Nearest]:
    """Returns the function from the first end minus the second, m, to the nearest place of the link."""
    return link.chain().nearest if isinstance(link, Shape | Guide) else _away


def _remembers(link: Link, distance: float, piece: int) -> bool:
    """Returns whether a place is so near the centre of a round that its normal is remembered."""
    if isinstance(link, Guide):
        return False
    radius = link.chain().pieces[piece].radius if isinstance(link, Shape) else abs(link.law().knots[-1][0])
    return (radius if isinstance(link, Shape) else 0.0) + distance < NEAR + NEAR_SHARE * radius


def _away(x: float, y: float) -> Nearest:
    d = math.hypot(x, y)
    return Nearest(d, (x / d, y / d), 1.0 / d) if d else Nearest(0.0, (1.0, 0.0), math.inf)
