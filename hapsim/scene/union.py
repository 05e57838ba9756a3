"""The outline of shapes that are one surface: the boundary of the union of their materials.

Pieces are cut at the vertices where they meet. Parts inside another shape are dropped, and so are pairs that face each
other, where shapes meet without a gap. What is left is followed with the free side on the right, at each vertex to the
next surface of the same free place. A place of the plane is a complex number, x + 1j y, in m.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from .chain import Chain, Piece

_SAME = 2e-9, 1.3e-8, 1e-12, 1.1e-7
"""m: nearer places are one. The further lengths are tried where walls that are nearly alike leave a loop open."""
_TOUCH = 1e-13  # m: deeper, arcs cross what they touch: by 1 nm, places of a round wall on a flat one are 1 um apart
_DUST = 1e-7  # m: a loop that is shorter is what rounding leaves between walls
_LOOSE = 1.5  # times that: so near a piece a vertex is on it
_FAR, _NEAR = 1e3, 1.0
"""m: half of a whole line that is cut, and of its part that comes from afar the last piece: a piece is known by its
start, and numbers of single precision are finer near it."""
_STRAIGHT, _CUSP = 1e-9, 1e-6  # rad: a smaller turn is none; nearer to half a turn it may be to either side
_DIGIT = 1e-14  # m and rad, by which pieces overlap, so that rounding parts none
_LONG = 16  # pieces
_SPARE = 1e-9  # m, and of a distance: how much further away than the nearest a piece may be to be looked at
_SHARES = np.array([0.5, 0.31, 0.73])  # of an edge: places that tell on which side of other shapes it is


class Outline(NamedTuple):
    """The boundary of the union of shapes.

    Attributes:
        chain: the pieces of all loops, and of lines from afar to afar. Where surfaces only touch, the tip of one may be
            at the place of the corner beside it. Both are as near then, and the first is felt: such corners come last.
        owners: of each piece the number of the shape on whose surface it lies; of a corner that of the piece before.
    """

    chain: Chain
    owners: tuple[int, ...]


class _LongChain(Chain):
    """A chain of many pieces, which looks only at the pieces near a place."""

    @cached_property
    def _columns(self) -> Any:
        """Start or centre, direction of a straight piece, its least and most extent, and the radius, (7, pieces)."""
        rows = []
        for one in self.pieces:
            straight = one.ex, one.ey, -math.inf if math.isinf(one.extent) else 0.0, one.extent
            rows.append((one.x, one.y, *((0.0,) * 4 if one.bend else straight), one.radius))
        return np.array(rows).T

    def _near(self, x: float, y: float) -> Sequence[int]:
        px, py, ex, ey, least, most, radius = self._columns
        dx, dy = x - px, y - py
        along = np.clip(dx * ex + dy * ey, least, most)
        off = np.abs(np.hypot(dx - along * ex, dy - along * ey) - radius)  # from the whole circle of an arc
        first = int(off.argmin())
        if self.pieces[first].opposite(x, y) is None:  # seldom
            first = next((i for i in off.argsort().tolist() if self.pieces[i].opposite(x, y) is not None), -1)
        return () if first < 0 else np.flatnonzero(off <= off[first] + _SPARE * (1.0 + abs(off[first]))).tolist()


class NothingFreeError(ValueError):
    """Shapes that leave no place free."""


class _Part(NamedTuple):
    """A straight piece, or an arc of at most half a turn, from `low` to `high` along piece `number` of a shape: m, or
    rad from the arc's start. `z`: its start or centre; `e`: its direction, or that of its start."""

    shape: int
    number: int
    bend: int
    z: complex
    e: complex
    radius: float
    low: float
    high: float

    def at(self, along: Any) -> Any:
        return self.z + self.e * (self.radius * np.exp(1j * self.bend * along) if self.bend else along)

    def along(self, p: Any) -> Any:
        """Returns where on it, or on what goes on beyond its ends, it is nearest to p."""
        w = (p - self.z) * self.e.conjugate()
        middle = 0.5 * (self.low + self.high)
        return middle + self.bend * np.angle(w * np.exp(-1j * self.bend * middle)) if self.bend else w.real

    def gap(self, p: Any) -> Any:
        """Returns the distance of p, m."""
        return np.abs(self.at(np.clip(self.along(p), self.low, self.high)) - p)

    def tangent(self, along: float) -> complex:
        return complex(self.e * (1j * self.bend * np.exp(1j * self.bend * along) if self.bend else 1.0))

    def ray(self, begin: complex, along: float, step: float) -> complex:
        """Returns the way from `begin`, a vertex, to the place that is a step before (less than 0) or after `along`."""
        turn = math.copysign(2.0 * math.asin(0.5 * abs(step) / self.radius), step) if self.bend else step
        return complex(self.at(along + turn) - begin)


class _Edge(NamedTuple):
    """Stretch of a part between two vertices."""

    part: int
    low: float
    high: float
    first: int
    last: int

    def goes_on(self, after: _Edge) -> bool:
        return self.part == after.part and self.high == after.low


def union(chains: Sequence[Chain]) -> Outline:
    """Returns the outline of shapes, each free on the right of its chain. A loop of which the others cut nothing keeps
    its pieces as they are. Raises NothingFreeError."""
    if len(chains) == 1:
        return Outline(chains[0], (0,) * len(chains[0].pieces))
    parts = [part for shape, chain in enumerate(chains) for part in _parts(shape, chain)]
    for same in _SAME:
        places, edges = _cut(parts, same)
        after = _successors(parts, places, _outer(parts, edges, chains, same))
        if after is not None:
            break
    else:
        raise ValueError("found walls that nearly meet in too many ways; expected them to meet, or a gap of 1 µm")
    outline = _assembled(chains, parts, places, after, same)
    if not outline.owners:
        raise NothingFreeError("the shapes leave no place free")
    return outline


def _parts(shape: int, chain: Chain) -> Iterator[_Part]:
    """Yields the parts of a chain that are longer than a point; a long arc has two."""
    for number, one in enumerate(chain.pieces):
        if not _is_point(one):
            stops = [-_FAR, _FAR] if math.isinf(one.extent) else [0.0, one.extent]
            if one.bend and one.extent > math.pi + _STRAIGHT:
                stops.insert(1, 0.5 * one.extent)
            for low, high in pairwise(stops):
                z, e = complex(one.x, one.y), complex(one.ex, one.ey)
                yield _Part(shape, number, one.bend, z, e, one.radius, low, high)


def _is_point(piece: Piece) -> bool:
    return piece.radius == 0.0 and (piece.bend != 0 or piece.extent == 0.0)


def _cut(parts: Sequence[_Part], same: float) -> tuple[Any, list[_Edge]]:
    """Returns places, of which some are vertices, and the edges between these."""
    ends = np.array([(part.at(part.low), part.at(part.high)) for part in parts])
    arc = np.array([part.radius * (1 + 1j) if part.bend else 0.0 for part in parts])
    around = np.column_stack([ends, [part.z if part.bend else part.at(part.low) for part in parts]])
    around = np.column_stack([around - arc[:, None], around + arc[:, None]])
    low, high = (
        around.view(float).reshape(len(parts), -1, 2).min(1),
        around.view(float).reshape(len(parts), -1, 2).max(1),
    )
    apart = (low[:, None] > high + same).any(2)
    pairs = [(i, j) for i, j in zip(*np.nonzero(~(apart | apart.T)), strict=True) if parts[i].shape < parts[j].shape]
    found = [(p, i, j) for i, j in pairs for p in _meet(parts[i], parts[j], same)]
    met, of = np.array([p for p, _, _ in found], complex), np.array([ij for _, *ij in found], int).reshape(-1, 2)
    for k, part in enumerate(parts):
        mine = (of == k).any(1)
        met[mine] = np.where(part.gap(met[mine]) <= _LOOSE * same, met[mine], np.nan)
    places = np.concatenate([ends.ravel(), met[np.isfinite(met)]])
    vertex = _vertices(places, same)
    leaders = np.unique(vertex)
    at = places[leaders, None].view(float)
    edges = []
    for k, part in enumerate(parts):
        near = leaders[((at >= low[k] - same) & (at <= high[k] + same)).all(1)]
        first, last = int(vertex[2 * k]), int(vertex[2 * k + 1])
        inner = [v for v in near[part.gap(places[near]) <= _LOOSE * same].tolist() if v not in (first, last)]
        stops = sorted((float(np.clip(part.along(places[v]), part.low, part.high)), v) for v in inner)
        stops = [(part.low, first), *stops, (part.high, last)]
        edges += [_Edge(k, a, b, v, w) for (a, v), (b, w) in pairwise(stops) if v != w]
    return places, edges


def _vertices(places: Any, same: float) -> Any:
    """Returns of each place the number of the one that stands for it, which is not further than `same`."""
    key = 0.8 * places.real + 0.6 * places.imag  # few walls stand across this
    stands, leaders = np.arange(len(places)), list[int]()
    for i in np.argsort(key, kind="stable").tolist():
        for j in reversed(leaders):
            if key[i] - key[j] > same:
                break
            if abs(places[i] - places[j]) <= same:
                stands[i] = j
                break
        if stands[i] == i:
            leaders.append(i)
    return stands


def _meet(a: _Part, b: _Part, same: float) -> list[complex]:
    """Returns the places where the lines and circles of two parts cross, or nearly touch."""
    if a.bend and not b.bend:
        a, b = b, a
    w, radius = b.z - a.z, b.radius
    if not b.bend:
        sine = (a.e.conjugate() * b.e).imag
        parts = abs(sine) * min(a.high - a.low, b.high - b.low) > same
        return [a.z + a.e * (w.conjugate() * b.e).imag / sine] if parts else []
    if not a.bend:
        w *= a.e.conjugate()
        foot, way, height = a.z + a.e * w.real, a.e, abs(w.imag)
        gap = height - radius
    else:
        away, radius = abs(w), a.radius
        if away <= same:
            return []
        ahead = 0.5 * (away + (a.radius - b.radius) * (a.radius + b.radius) / away)
        gap = max(away - a.radius - b.radius, abs(a.radius - b.radius) - away)
        touches, height = -_TOUCH <= gap <= same, abs(ahead)
        foot, way = a.z + w / away * (math.copysign(radius, ahead) if touches else ahead), 1j * w / away
    if -_TOUCH <= gap <= same:
        return [foot]
    half = math.sqrt(max((radius - height) * (radius + height), 0.0)) * way
    return [foot + half, foot - half] if height < radius else []


def _outer(parts: Sequence[_Part], edges: Sequence[_Edge], chains: Sequence[Chain], same: float) -> list[_Edge]:
    """Returns the edges that have a free place on their right: those not inside another shape, that face no other; of
    those that are alike the first."""
    spots = np.array([parts[edge.part].at(edge.low + _SHARES * (edge.high - edge.low)) for edge in edges])
    outside = np.ones((len(chains), len(edges)), bool)  # of each shape
    decided = np.zeros_like(outside)
    between = defaultdict[frozenset[int], list[int]](list)
    for i, edge in enumerate(edges):
        for j in between[frozenset(edge[-2:])]:
            one, other = parts[edge.part].shape, parts[edges[j].part].shape
            if one != other and abs(spots[i, 0] - spots[j, 0]) <= 4.0 * same:
                decided[other, i] = decided[one, j] = True
                outside[other, i] = False
                outside[one, j] &= edge.first == edges[j].first
        between[frozenset(edge[-2:])].append(i)
    for shape, chain in enumerate(chains):
        own = np.array([parts[edge.part].shape == shape for edge in edges])
        open_ = np.nonzero(~decided[shape] & ~own & outside.all(0))[0]
        distance = _distance(chain, spots[open_])
        outside[shape, open_] = np.take_along_axis(distance, np.abs(distance).argmax(1)[:, None], 1)[:, 0] > 0.0
    return [edges[i] for i in np.nonzero(outside.all(0))[0].tolist()]


def _distance(chain: Chain, p: Any) -> Any:
    """Returns the distance of places from a shape, m, positive where it is free."""
    least = np.full(p.shape, np.inf)
    for piece in chain.pieces:
        w = (p - complex(piece.x, piece.y)) * complex(piece.ex, -piece.ey)
        if piece.bend == 0:
            distance = -w.imag
            opposite = (w.real >= -_DIGIT) & (w.real <= piece.extent + _DIGIT) | math.isinf(piece.extent)
        else:
            distance = piece.bend * (np.abs(w) - piece.radius)
            middle = np.exp(-0.5j * piece.bend * piece.extent)
            opposite = np.abs(np.angle(w * middle)) <= 0.5 * piece.extent + _DIGIT
        least = np.where(opposite & (np.abs(distance) < np.abs(least)), distance, least)
    return least


def _successors(parts: Sequence[_Part], places: Any, edges: Sequence[_Edge]) -> dict[_Edge, _Edge | None] | None:
    """Returns of each edge the one that follows: at a vertex the first across the free place on its right, so that
    surfaces which only touch stay apart; None for one that ends afar. Returns None if a loop is open."""
    ins, outs = defaultdict(list), defaultdict(list)
    for edge in edges:
        if edge.low != -_FAR:
            outs[edge.first].append(edge)
        if edge.high != _FAR:
            ins[edge.last].append(edge)
    after: dict[_Edge, _Edge | None] = dict.fromkeys(edges)
    for vertex in ins.keys() | outs.keys():
        step = _step(places, *ins[vertex], *outs[vertex])
        for edge in ins[vertex]:
            back = parts[edge.part].ray(places[vertex], edge.high, -step)
            turns = [
                float(np.angle(parts[out.part].ray(places[vertex], out.low, step) / back)) % math.tau
                for out in outs[vertex]
            ]
            after[edge] = outs[vertex][int(np.argmin(turns))] if turns else None
        if len({after[edge] for edge in ins[vertex]} - {None}) != max(len(ins[vertex]), len(outs[vertex])):
            return None
    return after


def _step(places: Any, *edges: _Edge) -> float:
    """Returns a length within which these edges do not meet but at a vertex, m."""
    return 0.5 * min(float(abs(places[edge.first] - places[edge.last])) for edge in edges)


def _ways(after: Mapping[_Edge, _Edge | None]) -> Iterator[tuple[list[_Edge], bool]]:
    """Yields each line from afar and each loop (True); edges that go on along one part are one."""
    left = dict.fromkeys([*sorted(after.keys() - set(after.values())), *after])
    while left:
        begin: _Edge = next(iter(left))
        edge: _Edge | None = begin
        way = list[_Edge]()
        while edge is not None and edge in left:
            del left[edge]
            if way and way[-1].goes_on(edge):
                way[-1] = way[-1]._replace(high=edge.high, last=edge.last)
            else:
                way.append(edge)
            edge = after[edge]
        if edge is begin and len(way) > 1 and way[-1].goes_on(way[0]):
            last = way.pop()
            way[0] = last._replace(high=way[0].high, last=way[0].last)
        yield way, edge is begin


class _Joint(NamedTuple):
    """Joint of two edges: where one ends and the next begins along their parts, and its corners. `is_last`: hollow,
    at a vertex that other surfaces touch."""

    high: float
    low: float
    corners: Sequence[Piece] = ()
    is_last: bool = False


def _assembled(
    chains: Sequence[Chain], parts: Sequence[_Part], places: Any, after: Mapping[_Edge, _Edge | None], same: float
) -> Outline:
    """Returns the pieces along all edges, and the corners between them."""
    rows = list[tuple[Piece, int, bool]]()  # owner; whether it comes last
    count, passes = Counter(part.shape for part in parts), Counter(edge.last for edge in after)
    for way, closed in _ways(after):
        own = [parts[edge.part] for edge in way]
        sizes = [(edge.high - edge.low) * (one.radius if one.bend else 1.0) for one, edge in zip(own, way, strict=True)]
        if closed and sum(sizes) < _DUST:
            continue
        shape, is_cut = own[0].shape, [(one.low, one.high) != edge[1:3] for one, edge in zip(own, way, strict=True)]
        if {one.shape for one in own} == {shape} and len(own) == count[shape] and not any(is_cut):
            new = [(piece, shape, False) for piece in chains[shape].pieces]
        else:
            pairs = [*pairwise(way + way[:closed])]
            joints = [_joint(chains, parts, places, *pair, passes[pair[0].last] > 1, same) for pair in pairs]
            new = [*_along(chains, own, way, joints, closed)]
        n = len(new)
        for i, (piece, owner, is_last) in enumerate(new):
            joins = ((i - 1) % n, (i + 1) % n) if closed else (max(i - 1, 0), min(i + 1, n - 1))
            joined = piece._replace(before=joins[0] - i + len(rows), after=joins[1] - i + len(rows))
            rows.append((joined, owner, is_last))
    order = sorted(range(len(rows)), key=lambda i: rows[i][2])
    rank = np.argsort(order).tolist()
    pieces = (rows[i][0] for i in order)
    chain = Chain(tuple(piece._replace(before=rank[piece.before], after=rank[piece.after]) for piece in pieces))
    return Outline(chain if len(rows) < _LONG else _LongChain(*chain), tuple(rows[i][1] for i in order))


def _along(
    chains: Sequence[Chain], own: Sequence[_Part], way: Sequence[_Edge], joints: Sequence[_Joint], closed: bool
) -> Iterator[tuple[Piece, int, bool]]:
    for i, (part, edge) in enumerate(zip(own, way, strict=True)):
        piece = chains[part.shape].pieces[part.number]
        low = joints[i - 1].low if i or closed else edge.low
        high = joints[i].high if i < len(joints) else edge.high
        if (low, high) in ((0.0, piece.extent), (-_FAR, _FAR)):
            yield piece, part.shape, False
        else:
            stops = [low, high - _NEAR, high] if low == -_FAR < high - _NEAR else [low, high]
            for begin, end in pairwise(stops):
                z = complex(part.z if piece.bend else part.at(begin))
                e = complex(part.e * np.exp(1j * piece.bend * begin))
                new = piece._replace(x=z.real, y=z.imag, ex=e.real, ey=e.imag, extent=max(end - begin, 0.0))
                yield new if piece.bend else new._replace(ex=piece.ex, ey=piece.ey), part.shape, False
        if i < len(joints):
            yield from ((corner, part.shape, joints[i].is_last) for corner in joints[i].corners)


def _joint(
    chains: Sequence[Chain], parts: Sequence[_Part], places: Any, edge: _Edge, after: _Edge, crowded: bool, same: float
) -> _Joint:
    """Returns what joins two edges: the corner of a shape, a corner where two shapes cross, or nothing."""
    one, other = parts[edge.part], parts[after.part]
    if one.shape == other.shape and (edge.high, after.low) == (one.high, other.low):
        own, number, corners = chains[one.shape].pieces, one.number, list[Piece]()
        while (number := own[number].after) != other.number and _is_point(own[number]):
            corners.append(own[number])
        if number == other.number:
            return _Joint(edge.high, after.low, corners)
    vertex = complex(places[edge.last])
    found = [] if crowded else [p for p in _meet(one, other, same) if abs(p - vertex) <= 2.0 * _LOOSE * same]
    spot = complex(min(found, key=lambda p: abs(p - vertex), default=vertex))
    high, low = float(one.along(spot)), float(other.along(spot))
    ahead = one.tangent(high)
    turn = float(np.angle(other.tangent(low) / ahead))
    if abs(turn) <= _STRAIGHT:
        return _Joint(high, low)
    if abs(turn) > math.pi - _CUSP:  # a narrow gap if what follows is on the right, else a tip
        step = _step(places, edge, after)
        turn = math.copysign(turn, -np.angle(other.ray(spot, low, step) / one.ray(spot, high, -step)))
    side = math.copysign(1.0, turn)
    e = -1j * side * ahead
    return _Joint(
        high, low, [Piece(int(side), spot.real, spot.imag, e.real, e.imag, abs(turn))], crowded and side < 0.0
    )
