"""The outline of several shapes that are one surface: the boundary of the union of their materials.

Pieces are cut where they meet; those that lie inside another shape are dropped, and so are pairs that face each other,
where two shapes meet without a gap. What is left is followed with the free side on the right. Places nearer than 1 nm
are one. Numbers of the plane are complex: 1 is along x, 1j along y.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .chain import Chain, Piece

_SAME = 2e-9, 1.3e-8, 1e-12, 1.1e-7
"""m: nearer places are one. The further ones are tried where walls that are nearly alike leave a loop open."""
_FAR, _NEAR = 1e3, 1.0
"""m: half of a whole line, and of a cut one that comes from afar the last part. A piece is known by its start, and
numbers of single precision are finer near it."""
_STRAIGHT, _CUSP = 1e-9, 1e-6  # rad: a smaller turn is none; nearer to half a turn its side is looked at
_DIGIT = 1e-14  # m or rad: pieces overlap by this, so that rounding parts none
_SHARES = 0.5, 0.31, 0.73  # of an edge: places that tell on which side of other shapes it is

Values = NDArray[Any]


class Outline(NamedTuple):
    """The boundary of the union of shapes.

    Attributes:
        chain: the pieces of all loops, and of lines from afar to afar.
        owners: of each piece the number of the shape on whose surface it lies; of a corner that of the piece before.
    """

    chain: Chain
    owners: tuple[int, ...]


class NothingFreeError(ValueError):
    """Shapes that leave no place free."""


class _Pieces(NamedTuple):
    """Straight pieces and arcs of all shapes, without corners, as columns: shape, number in its chain, bend, start or
    centre, direction, radius, and the range along it: m, or rad of an arc."""

    shape: Values
    number: Values
    bend: Values
    z: Values
    e: Values
    radius: Values
    low: Values
    high: Values

    def take(self, which: Any) -> _Pieces:
        return _Pieces(*(column[which] for column in self))

    def at(self, along: Any) -> Values:
        return self.z + self.e * np.where(self.bend == 0, along, self.radius * np.exp(1j * self.bend * along))

    def tangent(self, along: Any) -> Values:
        return self.e * np.where(self.bend == 0, 1.0, 1j * self.bend * np.exp(1j * self.bend * along))

    def along(self, p: Any) -> Values:
        """Returns where on it, or on what goes on beyond its ends, it is nearest to p."""
        w = (p - self.z) * np.conj(self.e)
        turned = np.mod(self.bend * np.angle(w), 2.0 * math.pi)
        turned = np.where(turned > 0.5 * self.high + math.pi, turned - 2.0 * math.pi, turned)
        return np.where(self.bend == 0, w.real, turned)

    def clipped(self, p: Any) -> Values:
        return np.clip(self.along(p), self.low, self.high)

    def gap(self, p: Any) -> Values:
        """Returns the distance of p, m."""
        return np.abs(self.at(self.clipped(p)) - p)

    def box(self) -> Values:
        """Returns (4, K) m: left, low, right, high."""
        ends = np.array([self.at(self.low), self.at(self.high)])
        ends = np.where(self.bend == 0, ends, self.z + np.array([[-1 - 1j], [1 + 1j]]) * self.radius)
        return np.array([ends.real.min(0), ends.imag.min(0), ends.real.max(0), ends.imag.max(0)])


class _Edge(NamedTuple):
    """Part of a piece between two vertices."""

    piece: int
    low: float
    high: float
    first: int
    last: int


def union(chains: Sequence[Chain]) -> Outline:
    """Returns the outline of shapes, each free on the right of its chain. A shape that meets no other keeps its pieces
    as they are. Raises NothingFreeError."""
    if len(chains) == 1:
        return Outline(chains[0], (0,) * len(chains[0].pieces))
    pieces = _pieces(chains)
    for same in _SAME:
        places, edges, alone = _cut(pieces, len(chains), same)
        kept = _outer(pieces, edges, chains, same)
        ways = _ways(pieces, [edges[i] for i in kept])
        if ways is not None:
            break
    else:
        raise ValueError("walls that are nearly alike, but not quite, leave the outline open")
    if not ways:
        raise NothingFreeError("the shapes leave no place free")
    return _assembled(chains, pieces, places, ways, alone)


def _pieces(chains: Sequence[Chain]) -> _Pieces:
    rows = [
        (i, k, one.bend, complex(one.x, one.y), complex(one.ex, one.ey), one.radius, *_range(one))
        for i, chain in enumerate(chains)
        for k, one in enumerate(chain.pieces)
        if one.radius > 0.0 or (one.bend == 0 and one.extent > 0.0)
    ]
    return _Pieces(*(np.array(column) for column in zip(*rows, strict=True)))


def _range(piece: Piece) -> tuple[float, float]:
    return (0.0, piece.extent) if math.isfinite(piece.extent) else (-_FAR, _FAR)


def _cut(pieces: _Pieces, count: int, same: float) -> tuple[Values, list[_Edge], set[int]]:
    """Returns the vertices, the edges between them, and the shapes that meet no other."""
    box, number = pieces.box(), np.arange(len(pieces.bend))
    apart = (box[0] > box[2][:, None] + same) | (box[1] > box[3][:, None] + same)
    i, j = np.nonzero(~(apart | apart.T) & (pieces.shape[:, None] < pieces.shape))
    crossings = [*_crossings(pieces, i, j, same)]
    ends = np.concatenate([pieces.at(pieces.low), pieces.at(pieces.high)])
    points = np.concatenate([ends, *(p for p, _, _ in crossings)])
    on = np.concatenate([number, number, *(one for _, one, _ in crossings)])
    also = np.concatenate([number, number, *(one for _, _, one in crossings)])
    vertex = _clusters(points, same)
    places = points[: vertex.max() + 1].copy()
    places[vertex[::-1]] = points[::-1]  # the first of each
    edges, meets = list[_Edge](), np.zeros(count, bool)
    shapes = [set[int]() for _ in places]
    found = []
    for k in number.tolist():
        near = np.nonzero(
            (places.real >= box[0][k] - same) & (places.real <= box[2][k] + same)
            & (places.imag >= box[1][k] - same) & (places.imag <= box[3][k] + same)
        )[0]  # fmt: skip
        touched = near[pieces.take(k).gap(places[near]) <= same]
        found.append(np.union1d(touched, vertex[(on == k) | (also == k)]))
        for v in found[-1]:
            shapes[v].add(int(pieces.shape[k]))
    for k, own in enumerate(found):
        meets[pieces.shape[k]] |= any(len(shapes[v]) > 1 for v in own)
        edges += _edges(pieces.take(k), k, own, places, (vertex[k], vertex[len(number) + k]), same)
    return places, edges, set(np.nonzero(~meets)[0].tolist())


def _edges(piece: _Pieces, k: int, own: Values, places: Values, ends: tuple[int, int], same: float) -> Iterator[_Edge]:
    """Yields the parts of piece k between its vertices."""
    inner = own[(own != ends[0]) & (own != ends[1])]
    along = piece.clipped(places[inner])
    order = np.argsort(along)
    stops = [float(piece.low), *along[order].tolist(), float(piece.high)]
    names = [int(ends[0]), *inner[order].tolist(), int(ends[1])]
    size = float(piece.radius) if piece.bend else 1.0
    for low, high, first, last in zip(stops, stops[1:], names, names[1:], strict=False):
        if first != last or (high - low) * size > 10.0 * same:
            yield _Edge(k, low, high, first, last)


def _crossings(pieces: _Pieces, i: Values, j: Values, same: float) -> Iterator[tuple[Values, Values, Values]]:
    """Yields places where pieces i and j meet, with their numbers; of pieces that only touch, where they do."""
    swap = (pieces.bend[i] != 0) & (pieces.bend[j] == 0)
    i, j = np.where(swap, j, i), np.where(swap, i, j)
    bent_i, bent_j = pieces.bend[i] != 0, pieces.bend[j] != 0
    for which, places in (
        (~bent_i & ~bent_j, _of_lines),
        (~bent_i & bent_j, _of_line_and_circle),
        (bent_i & bent_j, _of_circles),
    ):
        m, n = i[which], j[which]
        a, b = pieces.take(m), pieces.take(n)
        for p in places(a, b, same):
            there = np.isfinite(p)
            there[there] = np.maximum(a.take(there).gap(p[there]), b.take(there).gap(p[there])) <= 2.0 * same
            yield p[there], m[there], n[there]


def _cross(a: Values, b: Values) -> Values:
    return (np.conj(a) * b).imag


def _of_lines(a: _Pieces, b: _Pieces, same: float) -> list[Values]:
    sine = _cross(a.e, b.e)
    parts = np.abs(sine) * np.minimum(a.high - a.low, b.high - b.low) > same
    along = _cross(b.z - a.z, b.e) / np.where(parts, sine, np.nan)
    return [a.z + along * a.e]


def _of_line_and_circle(a: _Pieces, b: _Pieces, same: float) -> list[Values]:
    w = (b.z - a.z) * np.conj(a.e)
    return [a.z + a.e * (w.real + s) for s in _chord(b.radius, np.abs(w.imag), same)]


def _of_circles(a: _Pieces, b: _Pieces, same: float) -> list[Values]:
    w = b.z - a.z
    d = np.abs(w)
    d = np.where(d > same, d, np.nan)
    ahead = 0.5 * (d + (a.radius - b.radius) * (a.radius + b.radius) / d)
    touch = (np.abs(d - a.radius - b.radius) <= same) | (np.abs(d - np.abs(a.radius - b.radius)) <= same)
    ahead = np.where(touch, np.copysign(a.radius, ahead), ahead)
    return [a.z + w / d * (ahead + 1j * s) for s in _chord(a.radius, np.abs(ahead), 0.0)]


def _chord(radius: Values, height: Values, same: float) -> tuple[Values, Values]:
    """Returns where a circle is met at this height, from the middle of the chord; 0 where it is touched, else nan."""
    half = np.sqrt(np.where(height <= radius + same, np.maximum((radius - height) * (radius + height), 0.0), np.nan))
    half = np.where(np.abs(height - radius) <= same, 0.0, half)
    return half, -half


def _clusters(points: Values, same: float) -> Values:
    """Returns the number of each point's vertex: those that steps of at most `same` join are one."""
    key = 0.8 * points.real + 0.6 * points.imag  # along no line that walls are likely to stand on
    order = np.argsort(key)
    key, sorted_points = key[order], points[order]
    label = np.arange(len(points))
    pairs, ahead = [], 1
    while ahead < len(points) and (near := np.nonzero(key[ahead:] - key[:-ahead] <= same)[0]).size:
        near = near[np.abs(sorted_points[near + ahead] - sorted_points[near]) <= same]
        pairs.append(np.array([order[near], order[near + ahead]]))
        ahead += 1
    m, n = np.concatenate(pairs, axis=1) if pairs else np.zeros((2, 0), int)
    while True:
        least = np.minimum(label[m], label[n])
        before = label.copy()
        np.minimum.at(label, m, least)
        np.minimum.at(label, n, least)
        if (label == before).all():
            return np.unique(label, return_inverse=True)[1]


def _outer(pieces: _Pieces, edges: Sequence[_Edge], chains: Sequence[Chain], same: float) -> list[int]:
    """Returns the numbers of the edges that have free places on their right: those that no other shape has inside, that
    do not face another's, and the first of those that are alike."""
    own = pieces.take([edge.piece for edge in edges])
    low, high = np.array([edge.low for edge in edges]), np.array([edge.high for edge in edges])
    spots = np.array([own.at(low + share * (high - low)) for share in _SHARES])
    middle = 0.5 * (low + high)
    heads, kept = own.tangent(middle), np.ones(len(edges), bool)
    alike = [{int(shape)} for shape in own.shape]
    between: dict[tuple[int, int], list[int]] = {}
    for i, edge in enumerate(edges):
        between.setdefault((min(edge.first, edge.last), max(edge.first, edge.last)), []).append(i)
    for together in between.values():
        for n, i in enumerate(together):
            for j in together[:n]:
                if own.shape[i] != own.shape[j] and abs(spots[0, i] - spots[0, j]) <= 4.0 * same:
                    alike[i].add(int(own.shape[j]))
                    alike[j].add(int(own.shape[i]))
                    faces = (heads[i] * np.conj(heads[j])).real < 0.0
                    kept[max(i, j)] = False
                    kept[min(i, j)] &= not faces
    for j, chain in enumerate(chains):
        others = np.nonzero(kept & np.array([j not in one for one in alike]))[0]
        depth = _distance(chain, spots[:, others])
        deepest = np.take_along_axis(depth, np.abs(depth).argmax(0)[None], 0)[0]
        kept[others] &= deepest > 0.0
    return np.nonzero(kept)[0].tolist()


def _distance(chain: Chain, p: Values) -> Values:
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


def _ways(pieces: _Pieces, edges: Sequence[_Edge]) -> list[list[_Edge]] | None:
    """Returns the edges in the order in which they are followed, by loop; a line begins afar. None if one is open."""
    leaving: dict[int, list[_Edge]] = {}
    arriving: dict[int, list[_Edge]] = {}
    for edge in edges:
        if edge.low > -_FAR:
            leaving.setdefault(edge.first, []).append(edge)
        if pieces.low[edge.piece] == 0.0 or edge.high < _FAR:
            arriving.setdefault(edge.last, []).append(edge)
    after: dict[_Edge, _Edge] = {}
    for vertex in leaving.keys() | arriving.keys():
        ins, outs = arriving.get(vertex, []), leaving.get(vertex, [])
        if len(ins) != len(outs):
            return None
        pairs = zip(ins, outs, strict=True) if len(ins) == 1 else _paired(pieces, ins, outs)
        after.update(pairs)
    if len(set(after.values())) < len(after):
        return None
    begins = set(edges) - set(after.values())
    ways, left = [], dict.fromkeys([*sorted(begins), *edges])
    while left:
        way = [next(iter(left))]
        del left[way[0]]
        while (following := after.get(way[-1])) in left and following is not None:
            way.append(following)
            del left[following]
        ways.append(_merged(way))
    return ways


def _paired(pieces: _Pieces, ins: Sequence[_Edge], outs: Sequence[_Edge]) -> Iterator[tuple[_Edge, _Edge]]:
    """Yields edges that arrive at a vertex with those that go on: the first ones across the free places on the right,
    so that surfaces which only touch stay apart."""
    step = _step(pieces, [*ins, *outs])
    angles = [np.angle(_ray(pieces, edge, step, leaves=True)) for edge in outs]
    for edge in ins:
        back = np.angle(_ray(pieces, edge, step, leaves=False))
        yield edge, outs[int(np.argmin([(angle - back) % (2.0 * math.pi) for angle in angles]))]


def _step(pieces: _Pieces, edges: Sequence[_Edge]) -> float:
    """Returns a length within which none of these edges meets another, m."""
    lengths = []
    for edge in edges:
        one = pieces.take(edge.piece)
        chord = abs(one.at(edge.high) - one.at(edge.low))
        lengths.append(0.5 * float(chord if edge.first != edge.last else one.radius))
    return min(lengths)


def _ray(pieces: _Pieces, edge: _Edge, step: float, *, leaves: bool) -> complex:
    """Returns the way from an edge's first or last place to that a step further on it."""
    piece = pieces.take(edge.piece)
    along = step if piece.bend == 0 else 2.0 * math.asin(0.5 * step / piece.radius)
    if leaves:
        return complex(piece.at(edge.low + along) - piece.at(edge.low))
    return complex(piece.at(edge.high - along) - piece.at(edge.high))


def _merged(way: list[_Edge]) -> list[_Edge]:
    """Returns the edges of a loop or line; those that go on along one piece are one."""
    merged = way[:1]
    for edge in way[1:]:
        if _goes_on(merged[-1], edge):
            merged[-1] = _both(merged[-1], edge)
        else:
            merged.append(edge)
    if len(merged) > 1 and merged[-1].last == merged[0].first and _goes_on(merged[-1], merged[0]):
        merged[0] = _both(merged.pop(), merged[0])
    return merged


def _goes_on(edge: _Edge, after: _Edge) -> bool:
    return edge.piece == after.piece and (edge.high == after.low or edge.high - after.low == 2.0 * math.pi)


def _both(edge: _Edge, after: _Edge) -> _Edge:
    return edge._replace(high=edge.high + after.high - after.low, last=after.last)


def _assembled(
    chains: Sequence[Chain], pieces: _Pieces, places: Values, ways: Sequence[Sequence[_Edge]], alone: set[int]
) -> Outline:
    found, owners = list[Piece](), list[int]()
    for way in ways:
        begin, shape = len(found), int(pieces.shape[way[0].piece])
        if shape in alone:
            own = chains[shape].pieces
            found += [one._replace(before=begin + one.before, after=begin + one.after) for one in own]
            owners += [shape] * len(own)
            continue
        closed, lows, highs = way[0].first == way[-1].last, [e.low for e in way], [e.high for e in way]
        corners: list[list[Piece]] = [[] for _ in way]
        for i in range(len(way) if closed else len(way) - 1):
            j = (i + 1) % len(way)
            corners[i], highs[i], lows[j] = _corner(chains, pieces, way[i], way[j], complex(places[way[i].last]))
        for edge, low, high, corner in zip(way, lows, highs, corners, strict=True):
            k = edge.piece
            shape = int(pieces.shape[k])
            new = [*_part(chains[shape].pieces[pieces.number[k]], pieces.take(k), low, high), *corner]
            found += new
            owners += [shape] * len(new)
        last = len(found) - 1
        for i in range(begin, len(found)):
            before, after = (
                (i - 1, i + 1) if not closed else (i - 1 if i > begin else last, i + 1 if i < last else begin)
            )
            found[i] = found[i]._replace(before=max(before, begin), after=min(after, last))
    return Outline(Chain(tuple(found)), tuple(owners))


def _corner(
    chains: Sequence[Chain], pieces: _Pieces, edge: _Edge, after: _Edge, vertex: complex
) -> tuple[list[Piece], float, float]:
    """Returns the corner between two edges, if there is one, and where the one ends and the other begins."""
    one, other = pieces.take([edge.piece]), pieces.take([after.piece])
    shape = int(one.shape[0])
    if shape == other.shape[0] and edge.high == one.high[0] and after.low == other.low[0]:
        own, corners = chains[shape].pieces, list[Piece]()
        k = own[one.number[0]].after
        while k != other.number[0] and _is_point(own[k]) and len(corners) < len(own):
            corners.append(own[k])
            k = own[k].after
        if k == other.number[0]:
            return corners, edge.high, after.low
    zero = np.zeros(1, int)
    met = [
        p for p, _, _ in _crossings(_Pieces(*map(np.concatenate, zip(one, other, strict=True))), zero, zero + 1, _SAME[0])
    ]
    spot = min([*np.concatenate(met), vertex], key=lambda p: abs(p - vertex) if p != vertex else 2.0 * _SAME[0])
    high, low = _near(one, spot, edge.high), _near(other, spot, after.low)
    if not (high > edge.low and low < after.high):
        spot, high, low = vertex, _near(one, vertex, edge.high), _near(other, vertex, after.low)
    ahead = complex(one.tangent(high)[0])
    turn = float(np.angle(complex(other.tangent(low)[0]) / ahead))
    if abs(turn) <= _STRAIGHT:
        return [], high, low
    if abs(turn) > math.pi - _CUSP:
        step = _step(pieces, [edge, after])
        back, away = _ray(pieces, edge, step, leaves=False), _ray(pieces, after, step, leaves=True)
        turn = -abs(turn) if np.angle(away / back) >= 0.0 else abs(turn)
    side = 1 if turn > 0.0 else -1
    e = -1j * side * ahead
    return [Piece(side, float(spot.real), float(spot.imag), e.real, e.imag, abs(turn))], high, low


def _is_point(piece: Piece) -> bool:
    return piece.radius == 0.0 and (piece.bend != 0 or piece.extent == 0.0)


def _near(one: _Pieces, spot: complex, about: float) -> float:
    """Returns where along a piece a spot is; of an arc the turn that is nearest to `about`."""
    along = float(one.along(spot)[0])
    return along + 2.0 * math.pi * round((about - along) / (2.0 * math.pi)) if one.bend[0] else along


def _part(piece: Piece, one: _Pieces, low: float, high: float) -> Iterator[Piece]:
    """Yields this part of a piece. A long arc is halved, so that its ends are told apart from any place."""
    if low == one.low and high == one.high:
        yield piece
        return
    stops = [low, high]
    if piece.bend and high - low > math.pi:
        stops = [low, 0.5 * (low + high), high]
    elif low == -_FAR < high - _NEAR:
        stops = [low, high - _NEAR, high]
    for begin, end in pairwise(stops):
        z = complex(one.at(begin)) if piece.bend == 0 else complex(one.z)
        e = complex(one.e) * (np.exp(1j * piece.bend * begin) if piece.bend else 1.0)
        yield piece._replace(x=z.real, y=z.imag, ex=float(e.real), ey=float(e.imag), extent=end - begin)
