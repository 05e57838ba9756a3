"""The links of the plane whose distance is that from a chain of pieces: the shape, with friction, and the guide.

A point that is free, or guided, has the distance from the nearest of all pieces. A point in contact with a shape stays
on its piece, and goes to the one before or after where its foot passes an end. So no thin wall is crossed, and no
corner jumps. MODULES.md has the rules.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType, all_of
from hapsim.cordis.dispatch import Column, Memory, Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of
from hapsim.cordis.modules.plane_links import EXACT, between, near_of, pull, turned
from hapsim.scene import Guide, Shape
from hapsim.scene.chain import Chain, Piece, Point

_INSIDE = 1e-9  # m, of another shape: a place that is less deep is on its surface
_SWEEPS, _SMALL = 40, 1e-12  # steps to the way out, and m: a smaller change ends them
_CUTS = 64  # places of a piece that are looked at
_FAR = 1e30  # m: extent of a whole line, and reach of a guide that never lets go
_MOST_WALKED = 64  # pieces in a sample
_DIGITS = 64  # last ones of a number, by which pieces overlap


class Chains(NamedTuple):
    """L chains of P pieces in all: chain i has those from begin[i] to before begin[i + 1].

    Attributes:
        before, after: (P,) numbers of the pieces that a piece's ends join.
        digit: (1,) by which pieces overlap, so that rounding parts none.
        near: (P,) m, from an arc's centre, within which a direction is remembered.
        bend, x, y, radius: (P,) as of a Piece.
        ex, ey: (P,) direction of a straight piece; of an arc from the centre to its middle.
        extent, sine: (P,) m, length of a straight piece; cosine and sine of half an arc's turn.
    """

    begin: NDArray[np.uint64]
    before: NDArray[np.uint64]
    after: NDArray[np.uint64]
    digit: Column
    near: Column
    bend: Column
    x: Column
    y: Column
    ex: Column
    ey: Column
    extent: Column
    sine: Column
    radius: Column


class Places(NamedTuple):
    """A place at each of L chains, shape (L,): number of the piece in its chain; normal (unit vector); `level`: m, such
    that the distance is n.r - level. `near` and `slack`: as of Directions."""

    near: Column
    piece: Column
    x: Column
    y: Column
    level: Column
    slack: Column


class Shapes(NamedTuple):
    """L shapes, shape (L,): K and B/T in N/m, friction coefficients. The bristle has K and B/T of its own, N/m, or
    shares of those of the surface. `group`: number of the first shape between the same ends; `out_x`, `out_y`: m, way
    out of those that are touched; `deep`: the part of each in it. Remembered: `touches`, 1 (-1 in the first sample) or
    0; `bent`, m; `sliding`, 1, -1 or 0; `press`, N."""

    ends: Ends
    chains: Chains
    place: Places
    group: NDArray[np.uint64]
    out_x: Column
    out_y: Column
    deep: Column
    stiffness: Column
    damping_per_sample: Column
    coefficient: Column
    static: Column
    bristle: Column
    stiffness_share: Column
    bristle_damping: Column
    damping_share: Column
    touches: Column
    bent: Column
    sliding: Column
    press: Column


class Guides(NamedTuple):
    """L guides, shape (L,): half the width and the reach in m, K and B/T in N/m."""

    ends: Ends
    chains: Chains
    place: Places
    half: Column
    reach: Column
    stiffness: Column
    damping_per_sample: Column


@helper
def find_nearest(chains, place, i, x, y):
    """Puts place i on the piece nearest to (x, y), and returns its distance, m; infinite where none is opposite."""
    real, first, digit = chains.x.dtype.type, chains.begin[i], chains.digit[0]
    nearest, found = real(np.inf) + (x - x) + (y - y), first + np.uint64(place.piece[i])
    nx, ny = place.x[i], place.y[i]
    for k in range(first, chains.begin[i + ONE]):
        dx, dy = x - chains.x[k], y - chains.y[k]
        along, bend = dx * chains.ex[k] + dy * chains.ey[k], chains.bend[k]
        if bend == 0:
            distance = dx * chains.ey[k] - dy * chains.ex[k]
            end, gap = chains.extent[k], digit * (abs(x) + abs(y) + abs(chains.x[k]) + abs(chains.y[k]))
            if abs(distance) < abs(nearest) and (-gap <= along <= end + gap or end >= real(_FAR)):
                nearest, found, nx, ny = distance, k, chains.ey[k], -chains.ex[k]
        else:
            away = math.sqrt(dx * dx + dy * dy)
            distance = bend * (away - chains.radius[k])
            if abs(distance) < abs(nearest) and along >= (chains.extent[k] - digit) * away:
                nearest, found = distance, k
                if away > 0:
                    nx, ny = bend * dx / away, bend * dy / away
                else:
                    nx, ny = bend * chains.ex[k], bend * chains.ey[k]
    place.piece[i], place.x[i], place.y[i] = real(found - first), nx, ny
    place.level[i], place.slack[i] = nx * x + ny * y - nearest, real(EXACT)
    return nearest


@helper
def follow(chains, place, i, x, y, gx, gy):
    """Moves place i along its chain to (x, y), which moved by (gx, gy), and returns its distance, m."""
    real, first, digit = chains.x.dtype.type, chains.begin[i], chains.digit[0]
    k = first + np.uint64(place.piece[i])
    nx, ny, distance = place.x[i], place.y[i], real(0)
    for _ in range(_MOST_WALKED):
        dx, dy, ex, ey = x - chains.x[k], y - chains.y[k], chains.ex[k], chains.ey[k]
        bend, to = chains.bend[k], k
        if bend == 0:
            nx, ny, along = ey, -ex, dx * ex + dy * ey
            if along < 0:
                to = chains.before[k]
            elif along > chains.extent[k]:
                to = chains.after[k]
            distance = nx * dx + ny * dy
        else:
            place.near[i] = chains.near[k]
            wx, wy = bend * nx, bend * ny
            if bend > 0 or chains.radius[k] > 0:
                wx, wy = turned(place, i, wx, wy, dx, dy, gx, gy)
            elif dx != 0 or dy != 0:
                away = math.sqrt(dx * dx + dy * dy)
                wx, wy = dx / away, dy / away
            c = chains.extent[k]
            if ex * wx + ey * wy < c - digit:
                aside = ex * wy - ey * wx
                to = chains.after[k] if bend * aside > 0 else chains.before[k]
                s = math.copysign(chains.sine[k], aside)
                wx, wy = c * ex - s * ey, s * ex + c * ey
            nx, ny = bend * wx, bend * wy
            distance = nx * dx + ny * dy - bend * chains.radius[k]
        if to == k:
            break
        k = to
    place.piece[i], place.x[i], place.y[i] = real(k - first), nx, ny
    place.level[i] = nx * x + ny * y - distance
    return distance


@action
def initialize(group, state):
    """Puts every place on the nearest piece."""
    group, state = value_of(group), value_of(state)
    for i in range(count(group.ends)):
        x, y, _, _ = between(group.ends, i, state)
        find_nearest(group.chains, group.place, i, x, y)


@action
def add_shape_forces(shapes, state):
    """Adds the force of every shape that is touched."""
    shapes, state = value_of(shapes), value_of(state)
    real, place = shapes.bent.dtype.type, shapes.place
    _find_ways_out(shapes, state)
    for i in range(count(shapes.ends)):
        x, y, gx, gy = between(shapes.ends, i, state)
        began, piece, nx, ny = shapes.touches[i] == 0, place.piece[i], place.x[i], place.y[i]
        out_x, out_y = x + shapes.out_x[shapes.group[i]], y + shapes.out_y[shapes.group[i]]
        nearest = real(0)
        if began:
            nearest = find_nearest(shapes.chains, place, i, out_x, out_y)
        if not nearest > 0:
            place.piece[i], place.x[i], place.y[i] = piece, nx, ny
            if not began:
                nearest = follow(shapes.chains, place, i, x, y, gx, gy)
            if began or nearest > 0:  # without the others it may be free, but not where they lead
                place.piece[i], place.x[i], place.y[i] = piece, nx, ny
                nearest = follow(shapes.chains, place, i, out_x, out_y, gx, gy)
            if nearest > 0 and not shapes.deep[i] > 0:
                nearest = find_nearest(shapes.chains, place, i, out_x, out_y)
                began = True
        if nearest > 0 and not shapes.deep[i] > 0:
            shapes.touches[i] = shapes.bent[i] = shapes.sliding[i] = shapes.press[i] = real(0)
        elif began:
            shapes.touches[i], shapes.bent[i], shapes.sliding[i] = real(-1), real(0), real(0)
    _find_ways_out(shapes, state)
    for i in range(count(shapes.ends)):
        deep, began = shapes.deep[i], shapes.touches[i] < 0
        if shapes.touches[i] == 0 or deep == 0:
            shapes.press[i] = real(0)
            continue
        shapes.touches[i] = real(1)
        _, _, gx, gy = between(shapes.ends, i, state)
        nx, ny = place.x[i], place.y[i]
        tension = shapes.damping_per_sample[i] * (nx * gx + ny * gy) - shapes.stiffness[i] * deep
        if tension > 0:
            tension = real(0)
        shapes.press[i] = -tension
        way = nx * gy - ny * gx
        rub = _rub(shapes, i, way, began)
        k = shapes.chains.begin[i] + np.uint64(place.piece[i])
        if shapes.chains.bend[k] < 0 and shapes.chains.extent[k] > 0:  # a hollow corner, where two walls damp
            rub += shapes.damping_per_sample[i] * way * deep / (shapes.chains.radius[k] + deep)
        pull(shapes.ends, i, tension * nx - rub * ny, tension * ny + rub * nx, state.force)


@inlined
def _find_ways_out(shapes, state):
    """Finds the shortest way from each point out of all shapes between the same ends that it touches, and the part of
    each in it, by Gauss and Seidel's steps. At its end a hand would be that had not entered them. A single shape has
    the distance from its surface; of two that coincide one has all, and in a corner both lead to where they meet."""
    place, real, touched = shapes.place, shapes.bent.dtype.type, 0
    for i in range(count(shapes.ends)):
        shapes.out_x[i] = shapes.out_y[i] = shapes.deep[i] = real(0)
        touched += shapes.touches[i] != 0
    for _ in range(_SWEEPS if touched > 1 else touched):
        most = real(0)
        for i in range(count(shapes.ends)):
            if shapes.touches[i] != 0:
                x, y, _, _ = between(shapes.ends, i, state)
                g, nx, ny = shapes.group[i], place.x[i], place.y[i]
                before = shapes.deep[i]
                deep = before + place.level[i] - nx * (x + shapes.out_x[g]) - ny * (y + shapes.out_y[g])
                if deep < 0:
                    deep = real(0)
                shapes.deep[i] = deep
                shapes.out_x[g] += (deep - before) * nx
                shapes.out_y[g] += (deep - before) * ny
                most = max(most, abs(deep - before))
        if not most > real(_SMALL):
            break


@inlined
def _rub(shapes, i, way, began):
    """Returns shape i's friction, N, which pulls along the tangent that is its normal turned left. `way`: m along it in
    this sample."""
    real, press, most = shapes.bent.dtype.type, shapes.press[i], shapes.static[i] * shapes.press[i]
    K = shapes.bristle[i] + shapes.stiffness_share[i] * shapes.stiffness[i]
    if not began:
        shapes.bent[i] += way
    if not shapes.sliding[i] * way >= 0:
        shapes.sliding[i] = real(0)
    rub = K * shapes.bent[i]
    if shapes.sliding[i] == 0:
        if abs(rub) > most:
            shapes.sliding[i] = math.copysign(real(1), rub)
        else:
            B = shapes.bristle_damping[i] + shapes.damping_share[i] * shapes.damping_per_sample[i]
            return min(max(rub + B * way, -most), most)
    rub = shapes.sliding[i] * shapes.coefficient[i] * press
    shapes.bent[i] = rub / K if K > 0 else real(0)
    return rub


@action
def add_guide_forces(guides, state):
    """Adds the force of every guide that the point is within the reach of."""
    guides, state = value_of(guides), value_of(state)
    place = guides.place
    for i in range(count(guides.ends)):
        x, y, gx, gy = between(guides.ends, i, state)
        distance = find_nearest(guides.chains, place, i, x, y)
        off = abs(distance) - guides.half[i]
        if not (off <= 0 or abs(distance) > guides.reach[i]):
            nx, ny = place.x[i], place.y[i]
            tension = math.copysign(guides.stiffness[i] * off, distance)
            tension += guides.damping_per_sample[i] * (nx * gx + ny * gy)
            k, rub = guides.chains.begin[i] + np.uint64(place.piece[i]), place.x.dtype.type(0)
            if guides.chains.bend[k] * distance > 0:  # outside a bend, or beyond an end, it holds along itself too
                share = off / (guides.chains.radius[k] + abs(distance))
                rub = guides.damping_per_sample[i] * share * (nx * gy - ny * gx)
            pull(guides.ends, i, tension * nx - rub * ny, tension * ny + rub * nx, state.force)


def _chains_of(chains: Sequence[Chain], context: BuildContext) -> Chains:
    """Returns these chains as numbers."""
    begin = np.cumsum([0, *(len(chain.pieces) for chain in chains)]).astype(np.uint64)
    rows, joins = [], []
    for first, chain in zip(begin.tolist(), chains, strict=False):
        rows += [_numbers_of(piece) for piece in chain.pieces]
        joins += [(first + piece.before, first + piece.after) for piece in chain.pieces]
    columns = [context.column(column) for column in zip(*rows, strict=True)]
    radii = [piece.radius for chain in chains for piece in chain.pieces]
    before, after = (np.array(side, np.uint64) for side in zip(*joins, strict=True))
    digit = context.column([_DIGITS * np.finfo(context.real).eps])
    return Chains(begin, before, after, digit, near_of(radii, context), *columns)


def _joined(chains: Sequence[Chain], group: Sequence[int]) -> list[Chain]:
    """Returns the boundaries without the ends of pieces that are inside other shapes of their group: an arc is shorter,
    and a straight piece has no way on. A contact stays there, so that a hand is not pressed through a joint of walls.
    """

    def around(at: Point, shapes: Iterable[int]) -> set[int]:
        return {i for i in shapes if chains[i].nearest(*at).distance < -_INSIDE}

    def cut(number: int, k: int, piece: Piece) -> Piece:
        others = [i for i, its in enumerate(group) if its == group[number] and i != number]
        first, last = around(piece.at(0.0), others), around(piece.at(1.0), others)
        if piece.bend == 0:
            return piece._replace(before=k if first else piece.before, after=k if last else piece.after)
        shares = [step / _CUTS for step in range(_CUTS + 1)] if first or last else []
        free = [share for share in shares if not around(piece.at(share), first | last)]
        if not free:
            return piece
        angle = piece.bend * free[0] * piece.extent
        c, s = math.cos(angle), math.sin(angle)
        ex, ey = c * piece.ex - s * piece.ey, s * piece.ex + c * piece.ey
        return piece._replace(ex=ex, ey=ey, extent=(free[-1] - free[0]) * piece.extent)

    return [
        Chain(
            tuple(cut(number, k, piece) for k, piece in enumerate(chain.pieces))
            if len(chain.pieces) > 1
            else chain.pieces
        )
        for number, chain in enumerate(chains)
    ]


def _numbers_of(piece: Piece) -> tuple[float, ...]:
    """Returns bend, x, y, ex, ey, extent, sine and radius, as of Chains."""
    if piece.bend == 0:
        extent = piece.extent if math.isfinite(piece.extent) else _FAR
        return 0.0, piece.x, piece.y, piece.ex, piece.ey, extent, 0.0, 0.0
    c, s = math.cos(0.5 * piece.extent), math.sin(0.5 * piece.extent)
    ex, ey = c * piece.ex - piece.bend * s * piece.ey, piece.bend * s * piece.ex + c * piece.ey
    return piece.bend, piece.x, piece.y, ex, ey, c, s, piece.radius


def _places(count: int, context: BuildContext, more: int = 0) -> tuple[Places, tuple[Column, ...]]:
    """Returns places, and `more` columns; all are remembered."""
    columns = tuple(np.zeros((6 + more, count), context.real))
    return Places(*columns[:6]), columns


def _shapes(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
    place, remembered = _places(len(links), context, 4)
    rows = []
    for link in links.values():
        K, B = link.bristle_stiffness, link.bristle_damping
        rows.append((K or 0.0, 0.5 * (K is None), (B or 0.0) * context.rate, float(B is None)))
    bristles = [context.column(column) for column in zip(*rows, strict=True)]
    ends = [link.between for link in links.values()]
    group = np.array([ends.index(one) for one in ends], np.uint64)
    ways_out = np.zeros((3, len(links)), context.real)
    chains = _chains_of(_joined([link.chain() for link in links.values()], group.tolist()), context)
    numbers = Shapes(ends_of(links, context), chains, place, group, *ways_out, *columns, *bristles, *remembered[6:])
    memory = Memory(tuple(links), remembered)
    return Part(numbers, initialize=initialize, add_forces=add_shape_forces, memory=memory)


def _guides(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Part:
    half = context.column([0.5 * link.width for link in links.values()])
    reach = context.column([_FAR if link.reach is None else link.reach for link in links.values()])
    place, remembered = _places(len(links), context)
    chains = _chains_of([link.chain() for link in links.values()], context)
    numbers = Guides(ends_of(links, context), chains, place, half, reach, *columns)
    return Part(numbers, initialize=initialize, add_forces=add_guide_forces, memory=Memory(tuple(links), remembered))


SHAPE = PartType(
    all_of(Shape, space=2), _shapes, name="shapes", compiled_as="a piece of its chain, a normal and a bristle each"
)
GUIDE = PartType(all_of(Guide, space=2), _guides, name="guides", compiled_as="the nearest of all pieces of its path")
