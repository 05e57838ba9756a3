"""The links of the plane whose distance is that from a chain of pieces: the shape, with friction, and the guide.

Shapes with the same two ends are one surface: its chain is the outline of their union. A point that is free, or guided,
has the distance from the nearest of all pieces. A point in contact with a surface has a place on it that moves along,
and goes to the piece before or after where its foot passes an end. So no thin wall is crossed, and no corner or joint
jumps. MODULES.md has the rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory, action
from hapsim.cordis.modules.link import Ends, count, ends_of
from hapsim.cordis.modules.plane_links import EXACT, between, near_of, pull, turned
from hapsim.scene import Guide, Shape
from hapsim.scene.chain import Chain, Piece
from hapsim.scene.modules.surfaces import surfaces_of

_FAR = 1e30  # m: extent of a whole line, and reach of a guide that never lets go
_MOST_WALKED = 64  # pieces in a sample
_DIGITS = 64  # last ones of a number, by which pieces overlap
_BESIDE = 1e-6  # m, from a surface: where a place is sought on an outline that changed, or a way begins


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
    """S surfaces of L shapes. A surface keeps its place, and all that it remembers, in the row of one of its shapes:
    that on whose surface the place is, so that memory and energy are known by the shape's name.

    Attributes:
        ends, chains: of the surfaces: the outlines of their shapes' unions.
        owner, sharer: (P,) number of the shape on whose surface a piece is; in a corner that two share, of the other.
        surface: (L,) number of each shape's surface.
        current, beside: (S,) the shape with the place; the same twice, but in a corner of two shapes both.
        stiffness, damping_per_sample, coefficient, static: (L,) K and B/T in N/m, friction coefficients.
        bristle, stiffness_share, bristle_damping, damping_share: (L,) the bristle's own K and B/T, N/m, and its shares
            of those of the surface.
        memory: (10, L) the columns of `place`, and the last four here.
        touches, bent, sliding, press: (L,) 1 or 0; m; 1, -1 or 0; N.
    """

    ends: Ends
    chains: Chains
    place: Places
    owner: NDArray[np.uint64]
    sharer: NDArray[np.uint64]
    surface: NDArray[np.uint64]
    current: NDArray[np.uint64]
    beside: NDArray[np.uint64]
    memory: NDArray[np.floating[Any]]
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
def find_nearest(chains, i, place, j, x, y):
    """Puts place j on the piece of chain i nearest to (x, y), and returns its distance, m; infinite where none is
    opposite."""
    real, first, digit = chains.x.dtype.type, chains.begin[i], chains.digit[0]
    nearest, found = real(np.inf) + (x - x) + (y - y), first + np.uint64(place.piece[j])
    nx, ny = place.x[j], place.y[j]
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
    place.piece[j], place.x[j], place.y[j] = real(found - first), nx, ny
    place.level[j], place.slack[j] = nx * x + ny * y - nearest, real(EXACT)
    return nearest


@helper
def follow(chains, i, place, j, x, y, gx, gy):
    """Moves place j along chain i to (x, y), which moved by (gx, gy), and returns its distance, m."""
    real, first, digit = chains.x.dtype.type, chains.begin[i], chains.digit[0]
    k = first + np.uint64(place.piece[j])
    nx, ny, distance = place.x[j], place.y[j], real(0)
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
            place.near[j] = chains.near[k]
            wx, wy = bend * nx, bend * ny
            if bend > 0 or chains.radius[k] > 0:
                wx, wy = turned(place, j, wx, wy, dx, dy, gx, gy)
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
    place.piece[j], place.x[j], place.y[j] = real(k - first), nx, ny
    place.level[j] = nx * x + ny * y - distance
    return distance


@inlined
def _left(chains, i, place, j, x, y, distance):
    """Returns a place just off place j, m, as (x, y) leaves it."""
    k, nx, ny = chains.begin[i] + np.uint64(place.piece[j]), place.x[j], place.y[j]
    off = chains.x.dtype.type(_BESIDE)
    if chains.bend[k] != 0:
        off += chains.bend[k] * chains.radius[k]
        return chains.x[k] + off * nx, chains.y[k] + off * ny
    return x + (off - distance) * nx, y + (off - distance) * ny


@helper
def _enter(chains, i, place, j, was_x, was_y, x, y):
    """Moves place j, which is on the nearest piece, to (x, y) from where the straight way from a free place goes in, if
    it does. Returns its distance, m."""
    real, first, digit, least = chains.x.dtype.type, chains.begin[i], chains.digit[0], chains.x.dtype.type(1)
    gx, gy = x - was_x, y - was_y
    for k in range(first, chains.begin[i + ONE]):
        dx, dy, ex, ey = was_x - chains.x[k], was_y - chains.y[k], chains.ex[k], chains.ey[k]
        bend, end, radius, share = chains.bend[k], chains.extent[k], chains.radius[k], real(-1)
        gap = digit * (abs(was_x) + abs(was_y) + abs(chains.x[k]) + abs(chains.y[k]))
        if bend == 0:
            out, inwards = dx * ey - dy * ex, gy * ex - gx * ey
            if inwards > 0:
                share = out / inwards
            along = (dx + share * gx) * ex + (dy + share * gy) * ey
            meets = -gap <= along <= end + gap or end >= real(_FAR)
        else:
            ahead, square = dx * gx + dy * gy, gx * gx + gy * gy
            root = ahead * ahead - square * (dx * dx + dy * dy - radius * radius)
            if root >= 0 and radius > 0 and square > 0:
                share = -(ahead + bend * math.sqrt(root)) / square
            meets = (dx + share * gx) * ex + (dy + share * gy) * ey >= (end - digit) * radius
        if meets and 0 <= share <= least:
            least = share
            place.piece[j] = real(k - first)
            if bend != 0:  # a straight piece has its own normal
                place.x[j], place.y[j] = bend * (dx + share * gx) / radius, bend * (dy + share * gy) / radius
    distance = follow(chains, i, place, j, x, y, gx, gy)
    return find_nearest(chains, i, place, j, x, y) if distance > 0 else distance


@action
def initialize_guides(guides, state):
    """Puts every place on the nearest piece."""
    guides, state = value_of(guides), value_of(state)
    for i in range(count(guides.ends)):
        x, y, _, _ = between(guides.ends, i, state)
        find_nearest(guides.chains, i, guides.place, i, x, y)


@action
def initialize_shapes(shapes, state):
    """Puts every place on the nearest piece, without a contact."""
    shapes, state = value_of(shapes), value_of(state)
    for j in range(np.uint64(shapes.surface.size)):
        _forget(shapes, j)
    for i in range(count(shapes.ends)):
        x, y, _, _ = between(shapes.ends, i, state)
        shapes.beside[i] = shapes.current[i] = shapes.owner[shapes.chains.begin[i]]
        find_nearest(shapes.chains, i, shapes.place, shapes.current[i], x, y)


@action
def resume_shapes(shapes, state):
    """Seeks every place that another program left on the outline, which may be another: a little outside of it. A place
    that is no longer there begins anew, as one without a contact does."""
    shapes, state = value_of(shapes), value_of(state)
    place, real = shapes.place, shapes.bent.dtype.type
    for i in range(count(shapes.ends)):
        x, y, _, _ = between(shapes.ends, i, state)
        touched, square = shapes.current[i], real(0)
        for j in range(np.uint64(shapes.surface.size)):
            is_beside = place.x[j] == 0 and place.y[j] == 0  # it has a part of the depth in a corner, or none
            if shapes.surface[j] == i and (is_beside or shapes.touches[j] > 0):
                deep = place.x[j] * x + place.y[j] * y - place.level[j]
                square += deep * deep
                touched = touched if is_beside else j
        nx, ny, slack, place.piece[touched] = place.x[touched], place.y[touched], place.slack[touched], real(0)
        out = math.sqrt(square) + real(_BESIDE)
        away = find_nearest(shapes.chains, i, place, touched, x + out * nx, y + out * ny)
        if shapes.touches[touched] > 0 and 0 < away < real(_BESIDE + _BESIDE):
            place.x[touched], place.y[touched], place.slack[touched] = nx, ny, slack
        else:
            _forget(shapes, touched)
            find_nearest(shapes.chains, i, place, touched, x, y)
        for j in range(np.uint64(shapes.surface.size)):
            if shapes.surface[j] == i and j != touched:
                _forget(shapes, j)
        shapes.current[i] = shapes.beside[i] = touched
        k = shapes.chains.begin[i] + np.uint64(place.piece[touched])
        if shapes.owner[k] != touched:
            _hand_over(shapes, i, touched, shapes.owner[k])


@inlined
def _forget(shapes, j):
    """Empties the row of shape j."""
    for row in range(np.uint64(shapes.memory.shape[0])):
        shapes.memory[row, j] = 0


@helper
def _hand_over(shapes, i, j, to):
    """Moves what surface i remembers from the row of shape j to that of another."""
    for row in range(np.uint64(shapes.memory.shape[0])):
        shapes.memory[row, to] = shapes.memory[row, j]
    _forget(shapes, j)
    shapes.current[i] = shapes.beside[i] = to


@action
def add_shape_forces(shapes, state):
    """Adds the force of every surface that is touched."""
    shapes, state = value_of(shapes), value_of(state)
    chains, place, real = shapes.chains, shapes.place, shapes.bent.dtype.type
    for i in range(count(shapes.ends)):
        x, y, gx, gy = between(shapes.ends, i, state)
        j, beside = shapes.current[i], shapes.beside[i]
        if beside != j:
            place.level[beside], shapes.beside[i] = real(0), j
        holds, distance = shapes.touches[j] > 0, real(0)
        if holds:
            distance = follow(chains, i, place, j, x, y, gx, gy)
            holds = not distance > 0
        if not holds:
            was_x, was_y = _left(chains, i, place, j, x, y, distance) if shapes.touches[j] > 0 else (x - gx, y - gy)
            distance = find_nearest(chains, i, place, j, x, y)
            if shapes.touches[j] > 0 or not distance > 0:  # a hand that was pressed deep may be beyond another wall
                distance = _enter(chains, i, place, j, was_x, was_y, x, y)
        k = chains.begin[i] + np.uint64(place.piece[j])
        if shapes.owner[k] != j:
            _hand_over(shapes, i, j, shapes.owner[k])
            j = shapes.owner[k]
        if not holds:
            shapes.touches[j] = real(0) if distance > 0 else real(1)
            shapes.bent[j] = shapes.sliding[j] = shapes.press[j] = real(0)
        if distance >= 0:
            shapes.press[j] = real(0)
            continue
        nx, ny, deep = place.x[j], place.y[j], -distance
        K, B = shapes.stiffness[j], shapes.damping_per_sample[j]
        tension, way = B * (nx * gx + ny * gy) - K * deep, nx * gy - ny * gx
        along = real(0)
        if chains.bend[k] < 0 and chains.extent[k] > 0:  # a hollow corner, where two walls hold and damp
            along = B * way * deep / (chains.radius[k] + deep)
            if shapes.sharer[k] != j:
                push, px, py = _share_corner(shapes, i, j, k, x, y, gx, gy, deep)
                tension -= push * (px * nx + py * ny)
                along -= push * (py * nx - px * ny)
        if tension > 0:
            tension = real(0)
        shapes.press[j] = -tension
        along += _rub(shapes, j, way, not holds)
        pull(shapes.ends, i, tension * nx - along * ny, tension * ny + along * nx, state.force)


@helper
def _share_corner(shapes, i, j, k, x, y, gx, gy, deep):
    """Returns how much more than shape j the other wall of the hollow corner k pushes, N, and its normal: in a corner
    of two shapes the way out has a part along the normal of each, and each holds its own part. Their shares of the
    energy are kept as the squares of two depths."""
    chains, place, other = shapes.chains, shapes.place, shapes.sharer[k]
    c, s, ex, ey = chains.extent[k], chains.sine[k], chains.ex[k], chains.ey[k]
    px, py, nx, ny = -(c * ex + s * ey), s * ex - c * ey, place.x[j], place.y[j]
    part = deep * ((c * ex - s * ey) * ny - (s * ex + c * ey) * nx) / ((s + s) * c)
    square = min(max(part * deep * (px * nx + py * ny), shapes.bent.dtype.type(0)), deep * deep)
    place.level[j] = nx * x + ny * y + math.sqrt(deep * deep - square)
    place.level[other], shapes.beside[i] = math.sqrt(square), other
    damping = shapes.damping_per_sample[other] - shapes.damping_per_sample[j]
    return (shapes.stiffness[other] - shapes.stiffness[j]) * part - damping * (px * gx + py * gy), px, py


@inlined
def _rub(shapes, j, way, began):
    """Returns shape j's friction, N, which pulls along the tangent that is its normal turned left. `way`: m along it in
    this sample."""
    real, press, most = shapes.bent.dtype.type, shapes.press[j], shapes.static[j] * shapes.press[j]
    K = shapes.bristle[j] + shapes.stiffness_share[j] * shapes.stiffness[j]
    if not began:
        shapes.bent[j] += way
    if not shapes.sliding[j] * way >= 0:
        shapes.sliding[j] = real(0)
    rub = K * shapes.bent[j]
    if shapes.sliding[j] == 0:
        if abs(rub) > most:
            shapes.sliding[j] = math.copysign(real(1), rub)
        else:
            B = shapes.bristle_damping[j] + shapes.damping_share[j] * shapes.damping_per_sample[j]
            return min(max(rub + B * way, -most), most)
    rub = shapes.sliding[j] * shapes.coefficient[j] * press
    shapes.bent[j] = rub / K if K > 0 else real(0)
    return rub


@action
def add_guide_forces(guides, state):
    """Adds the force of every guide that the point is within the reach of."""
    guides, state = value_of(guides), value_of(state)
    place = guides.place
    for i in range(count(guides.ends)):
        x, y, gx, gy = between(guides.ends, i, state)
        distance = find_nearest(guides.chains, i, place, i, x, y)
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


def _numbers_of(piece: Piece) -> tuple[float, ...]:
    """Returns bend, x, y, ex, ey, extent, sine and radius, as of Chains."""
    if piece.bend == 0:
        extent = piece.extent if math.isfinite(piece.extent) else _FAR
        return 0.0, piece.x, piece.y, piece.ex, piece.ey, extent, 0.0, 0.0
    c, s = math.cos(0.5 * piece.extent), math.sin(0.5 * piece.extent)
    ex, ey = c * piece.ex - piece.bend * s * piece.ey, piece.bend * s * piece.ex + c * piece.ey
    return piece.bend, piece.x, piece.y, ex, ey, c, s, piece.radius


def _remembered(count: int, context: BuildContext, more: int = 0) -> tuple[Places, NDArray[np.floating[Any]]]:
    """Returns places, and with them all columns that are remembered, of which `more` are others."""
    columns = np.zeros((6 + more, count), context.real)
    return Places(*columns[:6]), columns


def _shapes(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    place, remembered = _remembered(len(links), context, 4)
    rows, surfaces, number = [], surfaces_of(links), {name: i for i, name in enumerate(links)}
    for link in links.values():
        K, B = link.bristle_stiffness, link.bristle_damping
        rows.append((K or 0.0, 0.5 * (K is None), (B or 0.0) * context.rate, float(B is None)))
    bristles = [context.column(column) for column in zip(*rows, strict=True)]
    own = [[number[name] for name in one.shapes] for one in surfaces]
    of_surface, (current, beside) = np.zeros(len(links), np.uint64), np.zeros((2, len(surfaces)), np.uint64)
    for i, shapes in enumerate(own):
        of_surface[shapes] = i
    numbers = Shapes(
        ends_of({name: links[name] for one in surfaces for name in [*one.shapes][:1]}, context),
        _chains_of([one.outline.chain for one in surfaces], context),
        place,
        np.array([own[i][j] for i, one in enumerate(surfaces) for j in one.outline.owners], np.uint64),
        np.array([own[i][j] for i, one in enumerate(surfaces) for j in one.sharers], np.uint64),
        of_surface,
        current,
        beside,
        remembered,
        *columns,
        *bristles,
        *remembered[6:],
    )
    return Batch(
        numbers,
        initialize=initialize_shapes,
        add_forces=add_shape_forces,
        resume=resume_shapes,
        memory=Memory(tuple(links), place._asdict() | dict(zip(Shapes._fields[-4:], remembered[6:], strict=True))),
    )


def _guides(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    half = context.column([0.5 * link.width for link in links.values()])
    reach = context.column([_FAR if link.reach is None else link.reach for link in links.values()])
    place, _ = _remembered(len(links), context)
    chains = _chains_of([link.chain() for link in links.values()], context)
    numbers = Guides(ends_of(links, context), chains, place, half, reach, *columns)
    memory = Memory(tuple(links), place._asdict())
    return Batch(numbers, initialize=initialize_guides, add_forces=add_guide_forces, memory=memory)


SHAPE = BatchType(
    all_of(Shape, space=2),
    _shapes,
    name="shapes",
    compiled_as="one outline for those with the same ends; a piece of it, a normal and a bristle",
)
GUIDE = BatchType(all_of(Guide, space=2), _guides, name="guides", compiled_as="the nearest of all pieces of its path")
