"""Boundaries and paths in the plane: chains of straight pieces and arcs.

A chain is followed in one direction, and its free side is on the right: the normal of a tangent (tx, ty) is (ty, -tx).
So a boundary that is followed counterclockwise is free outside, and the same one reversed is free inside. An arc that
turns left is round for who stands on the free side, its centre in the material; one that turns right is hollow. A sharp
corner is an arc of radius 0. Every place in the plane is then opposite a piece.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

Point = tuple[float, float]

_CENTRE = 1e-150  # m: nearer a square is no number
_DIGIT = 1e-14  # m, rad: pieces overlap by this, so that rounding parts none
_STRAIGHT = 1e-9  # rad: a smaller turn is none
_FAR = 10.0  # m: half of a whole line in a picture


def remembered_within(radius: float) -> float:
    """Returns the distance from the centre of a round within which a direction is remembered, m. `radius`: of an arc,
    or the distance at which a link has no force. At 0.1 m/s and 1 kHz a hand moves 0.1 mm in a sample, so a direction
    turns by no more than about a radian."""
    return 1e-4 + 0.1 * abs(radius)


class Piece(NamedTuple):
    """A straight piece or an arc.

    Attributes:
        bend: 1 round (turns left), -1 hollow (turns right), 0 straight.
        x, y: m, start of a straight piece, centre of an arc.
        ex, ey: unit vector: direction of a straight piece, or from an arc's centre to its start.
        extent: m, length of a straight piece, infinite for a whole line; rad, turn of an arc.
        radius: m, of an arc.
        before, after: indices of the pieces that its ends join; its own at an open end.
    """

    bend: int
    x: float
    y: float
    ex: float
    ey: float
    extent: float
    radius: float = 0.0
    before: int = 0
    after: int = 0

    def at(self, share: float) -> Point:
        """Returns the place at this share of the piece's extent, m."""
        along = share * self.extent
        if self.bend == 0:
            return self.x + along * self.ex, self.y + along * self.ey
        c, s = math.cos(along), math.sin(along) * self.bend
        return self.x + self.radius * (c * self.ex - s * self.ey), self.y + self.radius * (s * self.ex + c * self.ey)

    def normal(self, share: float) -> Point:
        """Returns the unit vector into the free side there."""
        tx, ty = _tangent(self, share)
        return ty, -tx

    def opposite(self, x: float, y: float) -> Nearest | None:
        """Returns the place on this piece nearest to (x, y), if it is opposite the piece, else None."""
        dx, dy = x - self.x, y - self.y
        away = math.hypot(dx, dy)
        if self.bend == 0:
            digit = _DIGIT * max(away, 1.0)
            if math.isfinite(self.extent) and not -digit <= dx * self.ex + dy * self.ey <= self.extent + digit:
                return None
            normal = self.ey, -self.ex
            return Nearest(dx * normal[0] + dy * normal[1], normal, 0.0)
        turned = math.atan2(self.bend * (self.ex * dy - self.ey * dx), self.ex * dx + self.ey * dy)
        off = abs(math.remainder(turned - 0.5 * self.extent, math.tau)) - 0.5 * self.extent
        if off * (1.0 if self.radius else min(away, 1.0)) > _DIGIT:
            return None
        if away < _CENTRE:
            return Nearest(-self.bend * self.radius, (self.bend * self.ex, self.bend * self.ey), math.inf)
        normal = self.bend * dx / away, self.bend * dy / away
        return Nearest(self.bend * (away - self.radius), normal, self.bend / away)


class Nearest(NamedTuple):
    """A place as the nearest piece of a chain sees it.

    Attributes:
        distance: m, positive on the free side.
        normal: unit vector into the free side.
        curvature: 1/m, turn of the normal per metre along the chain at this distance: positive opposite a round.
        piece: index of the piece.
    """

    distance: float
    normal: Point
    curvature: float
    piece: int = 0


class Chain(NamedTuple):
    """Pieces that join end to end."""

    pieces: tuple[Piece, ...]

    def nearest(self, x: float, y: float) -> Nearest:
        """Returns (x, y) as the nearest piece sees it."""
        seen = ((i, self.pieces[i].opposite(x, y)) for i in self._near(x, y))
        each = [one._replace(piece=i) for i, one in seen if one is not None]
        if not each:  # between two pieces that rounding parts
            tiny = 1e-9 * max(abs(x), abs(y), 1e-3)
            return self.nearest(x + tiny, y + 0.7 * tiny)
        return min(each, key=lambda one: abs(one.distance))

    def _near(self, x: float, y: float) -> Sequence[int]:  # noqa: ARG002
        """Returns the numbers of pieces, ascending, among them each nearest one that (x, y) is opposite."""
        return range(len(self.pieces))

    def reversed(self) -> Chain:
        """Returns the same boundary followed the other way: free on the other side."""
        last, pieces = len(self.pieces) - 1, []
        for piece in reversed(self.pieces):
            (ex, ey), end = (-piece.ex, -piece.ey), (piece.x, piece.y)
            if piece.bend == 0 and math.isfinite(piece.extent):
                end = piece.at(1.0)
            elif piece.bend:
                c, s = math.cos(piece.extent), math.sin(piece.extent) * piece.bend
                ex, ey = c * piece.ex - s * piece.ey, s * piece.ex + c * piece.ey
            ends = last - piece.after, last - piece.before
            pieces.append(Piece(-piece.bend, *end, ex, ey, piece.extent, piece.radius, *ends))
        return Chain(tuple(pieces))

    def outline(self, most_turn: float = 0.1) -> list[Point]:
        """Returns points along the chain, m, for pictures: on arcs one for each `most_turn` rad."""
        points = []
        for piece in self.pieces:
            if piece.bend and piece.radius == 0.0:
                continue  # a corner, where another piece ends; or the end of a path
            if math.isinf(piece.extent):
                points += [(piece.x + far * piece.ex, piece.y + far * piece.ey) for far in (-_FAR, _FAR)]
                continue
            steps = max(1, math.ceil(piece.extent / most_turn)) if piece.bend else 1
            points += [piece.at(step / steps) for step in range(steps + 1)]
        return points


class TooRoundError(ValueError):
    """Corners that do not fit between their neighbours. `most`: m, the largest radius that does."""

    def __init__(self, most: float) -> None:
        super().__init__(f"a radius of {most:.3g} m is the largest that fits")
        self.most = most


def disc(radius: float) -> Chain:
    """Returns the boundary of a disc about (0, 0), free outside."""
    return Chain((Piece(1, 0.0, 0.0, 1.0, 0.0, 2.0 * math.pi, radius),))


def half_plane(normal: Point) -> Chain:
    """Returns the line through (0, 0) that is free where `normal` points."""
    size = math.hypot(*normal)
    return Chain((Piece(0, 0.0, 0.0, -normal[1] / size, normal[0] / size, math.inf),))


def capsule(first: Point, second: Point, radius: float) -> Chain:
    """Returns the boundary of all places nearer than `radius` to the line from one point to another, free outside."""
    (px, py), (qx, qy) = first, second
    length = math.hypot(qx - px, qy - py)
    tx, ty = (qx - px) / length, (qy - py) / length
    nx, ny = ty, -tx
    pieces = (
        Piece(0, px + radius * nx, py + radius * ny, tx, ty, length),
        Piece(1, qx, qy, nx, ny, math.pi, radius),
        Piece(0, qx - radius * nx, qy - radius * ny, -tx, -ty, length),
        Piece(1, px, py, -nx, -ny, math.pi, radius),
    )
    return _joined(pieces, closed=True)


def polygon(corners: Sequence[Point], radius: float = 0.0) -> Chain:
    """Returns the boundary of a polygon, free outside, with corners rounded to this radius. Raises TooRoundError."""
    area = sum(a[0] * b[1] - b[0] * a[1] for a, b in pairwise([*corners, corners[0]]))
    return _along(corners if area > 0.0 else list(reversed(corners)), radius, closed=True)


def straight_path(points: Sequence[Point], radius: float = 0.0, *, closed: bool = False) -> Chain:
    """Returns a path of straight lines, with corners rounded to this radius. Raises TooRoundError."""
    return _along(points, radius, closed=closed)


def smooth_path(points: Sequence[Point], *, closed: bool = False) -> Chain:
    """Returns a path through all points without a corner: two arcs from each point to the next."""
    around = [points[-1], *points, points[0]] if closed else list(points)
    inner = [_tangent_at(*three) for three in zip(around, around[1:], around[2:], strict=False)]
    tangents = inner
    if not closed:
        first, last = inner[:1] or [_direction(*points)], inner[-1:] or [_direction(*points)]
        begin, end = _direction(points[0], points[1]), _direction(points[-2], points[-1])
        tangents = [_mirrored(first[0], begin), *inner, _mirrored(last[0], end)]
    ends = [*zip(points, tangents, strict=True)]
    pieces: list[Piece] = []
    for (p, t), (q, u) in pairwise([*ends, ends[0]] if closed else ends):
        middle = _joint(p, t, q, u)
        first_arc = _arc(p, t, middle)
        pieces += [first_arc, _arc(middle, _end_tangent(first_arc), q)]
    return _joined(pieces, closed=closed)


def crossing(points: Sequence[Point], *, closed: bool) -> tuple[int, int] | None:
    """Returns the numbers of two sides that meet where they should not, the first such pair, else None."""
    sides = [*pairwise([*points, points[0]] if closed else points)]
    for i, (a, b) in enumerate(sides):
        for j, (c, d) in enumerate(sides[i + 1 :], i + 1):
            beside = j == i + 1 or (closed and (i, j) == (0, len(sides) - 1))
            turns = _turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b)
            if not beside and any(turns) and turns[0] * turns[1] <= 0.0 and turns[2] * turns[3] <= 0.0:
                return i, j
    return None


def _turn(a: Point, b: Point, c: Point) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _along(points: Sequence[Point], radius: float, *, closed: bool) -> Chain:
    """Returns straight lines from point to point, with an arc at each corner."""
    corners = list(_corners(points, closed))
    count = len(points)
    cuts = {i: radius * math.tan(0.5 * abs(turn)) for i, turn in corners}
    pieces: list[Piece] = []
    turns, most = dict(corners), math.inf
    for i in range(count if closed else count - 1):
        p, q = points[i], points[(i + 1) % count]
        tx, ty = _direction(p, q)
        length, first, last = math.dist(p, q), cuts.get(i, 0.0), cuts.get((i + 1) % count, 0.0)
        if first + last > length * (1.0 + 1e-12):
            most = min(most, radius * length / (first + last))
        pieces.append(Piece(0, p[0] + first * tx, p[1] + first * ty, tx, ty, max(length - first - last, 0.0)))
        turn = turns.get((i + 1) % count, 0.0)
        if abs(turn) > _STRAIGHT:
            x, y = pieces[-1].at(1.0)
            side = math.copysign(1.0, turn)
            pieces.append(
                Piece(
                    int(side), x - side * radius * ty, y + side * radius * tx, side * ty, -side * tx, abs(turn), radius
                )
            )
    if math.isfinite(most):
        raise TooRoundError(most)
    return _joined(pieces, closed=closed)


def _corners(points: Sequence[Point], closed: bool) -> Iterator[tuple[int, float]]:
    """Yields the index of each corner and its turn to the left, rad."""
    count = len(points)
    for i in range(count) if closed else range(1, count - 1):
        (ax, ay), (bx, by) = _direction(points[i - 1], points[i]), _direction(points[i], points[(i + 1) % count])
        yield i, math.atan2(ax * by - ay * bx, ax * bx + ay * by)


def _joined(pieces: Sequence[Piece], *, closed: bool) -> Chain:
    """Returns the pieces joined; an open chain gets a half turn of radius 0 about each end."""
    count = len(pieces)
    if closed:
        return Chain(tuple(one._replace(before=(i - 1) % count, after=(i + 1) % count) for i, one in enumerate(pieces)))
    inner = [one._replace(before=max(i - 1, 0), after=i + 1) for i, one in enumerate(pieces)]
    inner[0] = inner[0]._replace(before=count + 1)
    (bx, by), (ex, ey) = _tangent(pieces[0], 0.0), _end_tangent(pieces[-1])
    ends = (
        Piece(1, *pieces[-1].at(1.0), ey, -ex, math.pi, 0.0, count - 1, count - 1),
        Piece(1, *pieces[0].at(0.0), -by, bx, math.pi, 0.0, 0, 0),
    )
    return Chain((*inner, *ends))


def _direction(p: Point, q: Point) -> Point:
    size = math.dist(p, q)
    return (q[0] - p[0]) / size, (q[1] - p[1]) / size


def _tangent(piece: Piece, share: float) -> Point:
    """Returns the direction of a piece at this share of its extent."""
    if piece.bend == 0:
        return piece.ex, piece.ey
    angle = piece.bend * share * piece.extent
    c, s = math.cos(angle), math.sin(angle)
    x, y = c * piece.ex - s * piece.ey, s * piece.ex + c * piece.ey
    return -piece.bend * y, piece.bend * x


def _end_tangent(piece: Piece) -> Point:
    return _tangent(piece, 1.0)


def _tangent_at(p: Point, q: Point, r: Point) -> Point:
    """Returns the direction at q of the circle through three points."""
    first, second = math.dist(p, q), math.dist(q, r)
    (ax, ay), (bx, by) = _direction(p, q), _direction(q, r)
    x, y = ax * second + bx * first, ay * second + by * first
    size = math.hypot(x, y)
    return (x / size, y / size) if size > 1e-9 * (first + second) else (-ay, ax)


def _mirrored(tangent: Point, chord: Point) -> Point:
    """Returns the tangent at the other end of an arc with this chord."""
    twice = 2.0 * (tangent[0] * chord[0] + tangent[1] * chord[1])
    return twice * chord[0] - tangent[0], twice * chord[1] - tangent[1]


def _joint(p: Point, t: Point, q: Point, u: Point) -> Point:
    """Returns the point at which two arcs of equal tangent lengths meet, from p along t to q along u (Bolton, 1975)."""
    vx, vy = q[0] - p[0], q[1] - p[1]
    both = vx * (t[0] + u[0]) + vy * (t[1] + u[1])
    apart, square = 2.0 * (1.0 - t[0] * u[0] - t[1] * u[1]), vx * vx + vy * vy
    if apart > 1e-12:
        length = square / (both + math.sqrt(both * both + apart * square))
    else:
        length = 0.5 * square / both if abs(both) > 0.0 else 0.5 * math.sqrt(square)
    return 0.5 * (p[0] + q[0] + length * (t[0] - u[0])), 0.5 * (p[1] + q[1] + length * (t[1] - u[1]))


def _arc(p: Point, t: Point, q: Point) -> Piece:
    """Returns the arc from p along t to q; a straight piece where q is straight ahead."""
    cx, cy = q[0] - p[0], q[1] - p[1]
    cross, ahead, length = t[0] * cy - t[1] * cx, t[0] * cx + t[1] * cy, math.hypot(cx, cy)
    turn = 2.0 * math.atan2(abs(cross), ahead)
    if turn <= _STRAIGHT:
        return Piece(0, *p, *t, length)
    side, radius = math.copysign(1.0, cross), 0.5 * length * length / abs(cross)
    return Piece(
        int(side), p[0] - side * radius * t[1], p[1] + side * radius * t[0], side * t[1], -side * t[0], turn, radius
    )
