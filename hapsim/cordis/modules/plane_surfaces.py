"""The links of the plane whose distance is that from a chain of pieces: the shape, with friction, and the guide.

Shapes with the same two ends are one surface: its chain is the outline of their union. A point that is free, or guided,
has the distance from the nearest of all pieces; one in contact has a place that moves along. MODULES.md has the rules.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import helper, inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory, action
from hapsim.cordis.modules.link import Ends, count, ends_of
from hapsim.cordis.modules.plane_chains import (
    BESIDE,
    FAR,
    Chains,
    Places,
    chains_of,
    enter,
    find_nearest,
    follow,
    left,
    remembered_places,
)
from hapsim.cordis.modules.plane_links import between, pull
from hapsim.scene import Guide, Shape
from hapsim.scene.modules.surfaces import surfaces_of


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
        out = math.sqrt(square) + real(BESIDE)
        away = find_nearest(shapes.chains, i, place, touched, x + out * nx, y + out * ny)
        if shapes.touches[touched] > 0 and 0 < away < real(BESIDE + BESIDE):
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
            was_x, was_y = left(chains, i, place, j, x, y, distance) if shapes.touches[j] > 0 else (x - gx, y - gy)
            distance = find_nearest(chains, i, place, j, x, y)
            if shapes.touches[j] > 0 or not distance > 0:  # a hand that was pressed deep may be beyond another wall
                distance = enter(chains, i, place, j, was_x, was_y, x, y)
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


def _shapes(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    place, remembered = remembered_places(len(links), context, 4)
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
        chains_of([one.outline.chain for one in surfaces], context),
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
    reach = context.column([FAR if link.reach is None else link.reach for link in links.values()])
    place, _ = remembered_places(len(links), context)
    chains = chains_of([link.chain() for link in links.values()], context)
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
