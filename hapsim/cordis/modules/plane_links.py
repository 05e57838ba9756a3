"""The links between two points of the plane: spring, damper, visco-elastic link, links with knots, plectrum, friction.

A point of the plane is two points of a program, x and the one after it, y. With r the first end minus the second, n its
direction and g the growth of r in a sample, a link pulls its ends together by its tension over d = n.r, along n:

    F[n] = f(d[n]) + (z/T) n.g[n]

MODULES.md explains how n is remembered where the ends meet (`turned`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiling import helper, inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory, action, fma_action
from hapsim.cordis.modules.link import Ends, count, ends_of, link_type
from hapsim.cordis.modules.table_links import TableLinks, law_at, table_type, update_pieces
from hapsim.scene import Damper, Friction, Plectrum, Spring, ViscoElastic
from hapsim.scene.chain import remembered_within
from hapsim.scene.modules import Link

EXACT = -1.0
"""Slack of a direction that is not remembered."""

_AT_REST = 1e-4  # rad: by so much a direction that lags catches up in a sample without a way


class Directions(NamedTuple):
    """Directions of L links, shape (L,). `near`: m, from the centre, within which one is remembered.

    Attributes:
        x, y: unit vector of one that is remembered, else 0, and `slack`: m, of its way sideways, else EXACT.
        free_from: m², product of two places in a row above which none is remembered; infinite while one is.
    """

    near: Column
    x: Column
    y: Column
    slack: Column
    free_from: Column


class PlaneLinks(NamedTuple):
    """L links: K and B/T in N/m, length in m, shape (L,)."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    length: Column
    directions: Directions


class PlaneTables(NamedTuple):
    """L links with knots, and their directions."""

    table: TableLinks
    directions: Directions


class PlanePlectra(NamedTuple):
    """L plectra as on a line; `side`: 1 where it is released, else 0."""

    ends: Ends
    stiffness: Column
    damping_per_sample: Column
    release: Column
    length: Column
    directions: Directions
    side: Column


class PlaneFrictions(NamedTuple):
    """L links as on a line; x, y: m, the anchor."""

    ends: Ends
    force: Column
    static: Column
    stiffness: Column
    damping_per_sample: Column
    x: Column
    y: Column
    sliding: Column


@inlined
def between(ends, i, state):
    """Returns link i's first end minus its second (x, y), and the growth of both in a sample, m."""
    a, b = np.uint64(ends.first[i]), np.uint64(ends.second[i])
    one = np.uint64(1)
    x, y = state.position[a] - state.position[b], state.position[a + one] - state.position[b + one]
    before_x = state.previous[a] - state.previous[b]
    return x, y, x - before_x, y - (state.previous[a + one] - state.previous[b + one])


@inlined
def pull(ends, i, x, y, force):
    """Pulls link i's ends together by a force with these components, N."""
    a, b = np.uint64(ends.first[i]), np.uint64(ends.second[i])
    one = np.uint64(1)
    force[a] -= x
    force[a + one] -= y
    force[b] += x
    force[b + one] += y


@inlined
def turned(directions, i, nx, ny, x, y, gx, gy):
    """Returns direction i, (nx, ny) before, of a place (x, y) from the centre that moved by (gx, gy) in this sample, m:
    the place's own, except near the centre and until it has caught up after that."""
    ahead = nx * x + ny * y
    if ahead > directions.near[i] and directions.slack[i] == directions.near.dtype.type(EXACT):
        size = math.sqrt(x * x + y * y)
        return x / size, y / size
    return _turned_slowly(directions, i, nx, ny, ahead, nx * y - ny * x, gx, gy)


@helper
def _turned_slowly(directions, i, nx, ny, ahead, aside, gx, gy):
    """Returns a direction after a sample. Near the centre and beyond it, it turns towards the place alone, which never
    adds energy, and by way sideways over `near` alone, less what may be noise: a tenth of `near` either way. Else it
    catches up by the way over `near`."""
    near, slack, real = directions.near[i], directions.slack[i], directions.near.dtype.type
    angle = math.atan2(aside, ahead)
    if ahead > near:
        most = math.sqrt(gx * gx + gy * gy) / near + real(_AT_REST)
        directions.slack[i] = real(EXACT) if most >= abs(angle) else real(0)
    else:
        play = real(0.1) * near
        slack = nx * gy - ny * gx + (real(0) if slack == real(EXACT) else slack)
        directions.slack[i] = min(max(slack, -play), play)
        beyond = slack - directions.slack[i]
        most = abs(beyond) / near if beyond * aside > 0 else real(0)
    most = min(most, abs(angle), real(1))
    c, s = math.cos(most), math.copysign(math.sin(most), angle)
    return c * nx - s * ny, s * nx + c * ny


@inlined
def turn(directions, i, x, y, gx, gy):
    """Returns direction i of a place (x, y) from the other end that moved by (gx, gy) in this sample, m."""
    if x * (x - gx) + y * (y - gy) > directions.free_from[i]:
        size = math.sqrt(x * x + y * y)
        return x / size, y / size
    return _remember(directions, i, x, y, gx, gy)


@helper
def _remember(directions, i, x, y, gx, gy):
    """Turns and remembers direction i as `turned` does; until then it was that of the place before."""
    nx, ny, real = directions.x[i], directions.y[i], directions.near.dtype.type
    if nx == 0 and ny == 0:
        size = math.sqrt((x - gx) * (x - gx) + (y - gy) * (y - gy))
        nx, ny = ((x - gx) / size, (y - gy) / size) if size > 0 else (real(1), real(0))
    nx, ny = turned(directions, i, nx, ny, x, y, gx, gy)
    if directions.slack[i] == real(EXACT):
        directions.x[i] = directions.y[i] = real(0)
        directions.free_from[i] = directions.near[i] * directions.near[i]
    else:
        directions.x[i], directions.y[i], directions.free_from[i] = nx, ny, real(np.inf)
    return nx, ny


@fma_action
def add_forces(links, state):
    """Adds the force of every straight link: K (r - length n) and the damper along n. A direction that is not
    remembered is not worked out: one division less is a third of the time."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        x, y, gx, gy = between(links.ends, i, state)
        K = links.stiffness[i]
        if x * (x - gx) + y * (y - gy) > links.directions.free_from[i]:
            square = x * x + y * y
            along = (
                K + (links.damping_per_sample[i] * (x * gx + y * gy) - K * links.length[i] * math.sqrt(square)) / square
            )
            pull(links.ends, i, along * x, along * y, state.force)
        else:
            nx, ny = _remember(links.directions, i, x, y, gx, gy)
            along = links.damping_per_sample[i] * (nx * gx + ny * gy) - K * links.length[i]
            pull(links.ends, i, K * x + along * nx, K * y + along * ny, state.force)


@action
def retarget_tables(links, _state):
    """Computes the numbers that depend on the live ones."""
    update_pieces(value_of(links).table)


@action
def add_table_forces(links, state):
    """Adds the force of every link with knots, by its distance."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.table.ends)):
        x, y, gx, gy = between(links.table.ends, i, state)
        nx, ny = turn(links.directions, i, x, y, gx, gy)
        d = nx * x + ny * y
        if not d >= links.table.nothing_from[i]:
            tension, _, damping = law_at(links.table, i, d)
            tension = min(tension + damping * (nx * gx + ny * gy), links.table.most[i])
            pull(links.table.ends, i, tension * nx, tension * ny, state.force)


@action
def add_plectrum_forces(links, state):
    """Adds the force of every plectrum that grips. One that released grips again within a tenth of its release."""
    links, state = value_of(links), value_of(state)
    real = links.release.dtype.type
    for i in range(count(links.ends)):
        x, y, gx, gy = between(links.ends, i, state)
        nx, ny = turn(links.directions, i, x, y, gx, gy)
        reach = real(0.1) * links.release[i] if links.side[i] > 0 else links.release[i]
        if x * x + y * y > reach * reach:
            links.side[i] = real(1)
        else:
            links.side[i] = real(0)
            K, damper = links.stiffness[i], links.damping_per_sample[i] * (nx * gx + ny * gy)
            pull(links.ends, i, K * x + damper * nx, K * y + damper * ny, state.force)


@action
def initialize_friction(links, state):
    """Sets every anchor so that no bristle is bent."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        links.x[i], links.y[i], _, _ = between(links.ends, i, state)


@action
def add_friction_forces(links, state):
    """Adds the force of every friction link, a bristle that bends any way."""
    links, state = value_of(links), value_of(state)
    real = links.x.dtype.type
    for i in range(count(links.ends)):
        x, y, gx, gy = between(links.ends, i, state)
        K, B = links.stiffness[i], links.damping_per_sample[i]
        bent_x, bent_y = x - links.x[i], y - links.y[i]
        if not (bent_x - gx) * gx + (bent_y - gy) * gy >= 0:
            links.sliding[i] = real(0)
        bent = K * math.sqrt(bent_x * bent_x + bent_y * bent_y)
        if bent > links.static[i]:
            links.sliding[i] = real(1)
        if links.sliding[i] > 0 and bent > 0:
            share = links.force[i] / bent
            links.x[i], links.y[i] = x - share * bent_x, y - share * bent_y
            pull(links.ends, i, share * K * bent_x, share * K * bent_y, state.force)
        else:
            pull(links.ends, i, K * bent_x + B * gx, K * bent_y + B * gy, state.force)


def near_of(radii: Iterable[float], context: BuildContext) -> Column:
    """Returns `near` of directions about rounds with these radii, m."""
    return context.column([*map(remembered_within, radii)])


def _plane_type(
    module: type[Link], name: str, numbers: Callable[..., Any], forces: NativeFunction, words: str = "", *more: str
) -> BatchType:
    """Returns the type of the links of a module type with a direction each, and columns of memory with these names.

    Args:
        numbers: makes the part's numbers of ends, live columns, lengths, directions, and those columns.
        name, words: as of `BatchType`.
    """

    def build(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
        directions, remembered = _directions(links, context, *more)
        lengths = context.column([link.law().rest for link in links.values()])
        own = numbers(ends_of(links, context), *columns, lengths, directions, *[*remembered.values()][4:])
        return Batch(own, add_forces=forces, memory=Memory(tuple(links), remembered))

    return BatchType(
        all_of(module, space=2), build, name=f"{name} in the plane", compiled_as=f"{words}a direction each"
    )


def _directions(links: Mapping[str, Any], context: BuildContext, *more: str) -> tuple[Directions, dict[str, Column]]:
    """Returns the directions of links, and what is remembered of them, with more columns of these names."""
    near = near_of([link.law().rest for link in links.values()], context)
    remembered = {name: np.zeros_like(near) for name in (*Directions._fields[1:], *more)}
    remembered["slack"][:], remembered["free_from"][:] = EXACT, near * near
    return Directions(near, *[*remembered.values()][:4]), remembered


def _tables(table: TableLinks, links: Mapping[str, Any], context: BuildContext) -> Batch:
    directions, remembered = _directions(links, context)
    return Batch(
        PlaneTables(table, directions),
        initialize=retarget_tables,
        retarget=retarget_tables,
        add_forces=add_table_forces,
        memory=Memory(tuple(links), remembered),
    )


PLANE_VISCOELASTIC = _plane_type(ViscoElastic, "visco-elastic links", PlaneLinks, add_forces)
PLANE_SPRING = _plane_type(
    Spring, "springs", lambda ends, K, *rest: PlaneLinks(ends, K, np.zeros_like(K), *rest), add_forces
)
PLANE_DAMPER = _plane_type(
    Damper, "dampers", lambda ends, B, *rest: PlaneLinks(ends, np.zeros_like(B), B, *rest), add_forces
)
PLANE_TABLES = table_type(
    lambda link: link.table(),
    _tables,
    "contacts, curves and clicks in the plane",
    links_of=lambda scene: scene.plane_links,
    words="a search in each one's knots; a direction each",
)
PLANE_PLECTRUM = _plane_type(Plectrum, "plectra", PlanePlectra, add_plectrum_forces, "a grip and ", "side")
PLANE_FRICTION = link_type(
    Friction, PlaneFrictions, add_friction_forces, "friction links in the plane", "an anchor each",
    remembers=3, initialize=initialize_friction, space=2,
)  # fmt: skip
