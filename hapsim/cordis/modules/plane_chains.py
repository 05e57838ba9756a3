"""Chains of pieces in the plane: the nearest place on one, and a place that moves along.

A place on a chain moves along with a point, and goes to the piece before or after where its foot passes an end: so no
thin wall is crossed, and no corner or joint jumps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import helper, inlined
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Column
from hapsim.cordis.modules.plane_links import EXACT, near_of, turned
from hapsim.scene.chain import Chain, Piece

FAR = 1e30  # m: extent of a whole line, and reach of a guide that never lets go
BESIDE = 1e-6  # m, from a surface: where a place is sought on an outline that changed, or a way begins
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
            if abs(distance) < abs(nearest) and (-gap <= along <= end + gap or end >= real(FAR)):
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
def left(chains, i, place, j, x, y, distance):
    """Returns a place just off place j, m, as (x, y) leaves it."""
    k, nx, ny = chains.begin[i] + np.uint64(place.piece[j]), place.x[j], place.y[j]
    off = chains.x.dtype.type(BESIDE)
    if chains.bend[k] != 0:
        off += chains.bend[k] * chains.radius[k]
        return chains.x[k] + off * nx, chains.y[k] + off * ny
    return x + (off - distance) * nx, y + (off - distance) * ny


@helper
def enter(chains, i, place, j, was_x, was_y, x, y):
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
            meets = -gap <= along <= end + gap or end >= real(FAR)
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


def chains_of(chains: Sequence[Chain], context: BuildContext) -> Chains:
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
        extent = piece.extent if math.isfinite(piece.extent) else FAR
        return 0.0, piece.x, piece.y, piece.ex, piece.ey, extent, 0.0, 0.0
    c, s = math.cos(0.5 * piece.extent), math.sin(0.5 * piece.extent)
    ex, ey = c * piece.ex - piece.bend * s * piece.ey, piece.bend * s * piece.ex + c * piece.ey
    return piece.bend, piece.x, piece.y, ex, ey, c, s, piece.radius


def remembered_places(count: int, context: BuildContext, more: int = 0) -> tuple[Places, NDArray[np.floating[Any]]]:
    """Returns places, and with them all columns that are remembered, of which `more` are others."""
    columns = np.zeros((6 + more, count), context.real)
    return Places(*columns[:6]), columns
