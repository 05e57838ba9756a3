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
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, LiveColumn, PartType
from hapsim.cordis.dispatch import Column, Memory, Part, action, fma_action
from hapsim.cordis.modules.link import Ends, count, link_type
from hapsim.cordis.modules.table_links import TableLinks, knot_columns, law_at, table_numbers, update_pieces
from hapsim.laws import Law
from hapsim.scene import Damper, Friction, Plectrum, Scene, Spring, ViscoElastic
from hapsim.scene.modules import Link

NEAR, NEAR_SHARE = 1e-4, 0.1
"""m, and share of the radius: nearer to its centre than these together a direction is remembered. At 0.1 m/s and 1 kHz
a hand moves 0.1 mm in a sample, so that a direction turns by no more than about a radian."""

_TINY = 1e-16  # m²: a hand at rest has a way too, of 10 nm, by which a direction that lags catches up


class Directions(NamedTuple):
    """Directions of L links, unit vectors, shape (L,). `near`: m, from the centre, within which they are remembered;
    `slack`: m, of the way sideways there."""

    near: Column
    x: Column
    y: Column
    slack: Column


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
    """Returns a direction after a sample, of a place (x, y) from the centre that moved by (gx, gy), all in m: the
    place's own, unless that is near the centre or would turn by more than the place's way over `near`."""
    near, tiny = directions.near[i], directions.near.dtype.type(_TINY)
    ahead, aside, way = nx * x + ny * y, nx * y - ny * x, gx * gx + gy * gy + tiny
    if ahead > near and aside * aside * (near * near) <= ahead * ahead * way:
        size = math.sqrt(x * x + y * y)
        return x / size, y / size
    return _turned_slowly(directions, i, nx, ny, ahead, aside, nx * gy - ny * gx, math.sqrt(way))


@helper
def _turned_slowly(directions, i, nx, ny, ahead, aside, sideways, way):
    """Returns the direction of a place that is near the centre or beyond it. There it turns towards the place alone,
    which never adds energy, and by way sideways alone, less what may be noise: a tenth of `near` either way."""
    near, real = directions.near[i], directions.near.dtype.type
    most = way / near
    if ahead > near:
        directions.slack[i] = real(0)
    else:
        slack, play = directions.slack[i] + sideways, real(0.1) * near
        directions.slack[i] = min(max(slack, -play), play)
        beyond = slack - directions.slack[i]
        most = abs(beyond) / near if beyond * aside > 0 else real(0)
    angle = math.atan2(aside, ahead)
    most = min(most, abs(angle), real(1))
    c, s = math.cos(most), math.copysign(math.sin(most), angle)
    return c * nx - s * ny, s * nx + c * ny


@inlined
def turn(directions, i, x, y, gx, gy):
    """Turns direction i to its place, and returns it."""
    nx, ny = turned(directions, i, directions.x[i], directions.y[i], x, y, gx, gy)
    directions.x[i], directions.y[i] = nx, ny
    return nx, ny


@inlined
def point_at_ends(directions, ends, state):
    """Sets every direction to that of its ends; to x where they coincide."""
    real = directions.x.dtype.type
    for i in range(count(ends)):
        x, y, _, _ = between(ends, i, state)
        size = math.sqrt(x * x + y * y)
        directions.x[i], directions.y[i] = (x / size, y / size) if size > 0 else (real(1), real(0))


@action
def initialize(links, state):
    """Sets every direction to that of its ends."""
    links, state = value_of(links), value_of(state)
    point_at_ends(links.directions, links.ends, state)


@fma_action
def add_forces(links, state):
    """Adds the force of every straight link: K (r - length n) and the damper along n."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        x, y, gx, gy = between(links.ends, i, state)
        nx, ny = turn(links.directions, i, x, y, gx, gy)
        K = links.stiffness[i]
        along = links.damping_per_sample[i] * (nx * gx + ny * gy) - K * links.length[i]
        pull(links.ends, i, K * x + along * nx, K * y + along * ny, state.force)


@action
def initialize_tables(links, state):
    """Computes the numbers that depend on the live ones, and sets every direction to that of its ends."""
    links, state = value_of(links), value_of(state)
    update_pieces(links.table)
    point_at_ends(links.directions, links.table.ends, state)


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
    return context.column([NEAR + NEAR_SHARE * abs(radius) for radius in radii])


def _straight_type(
    module: type[Link], name: str, both: Callable[[Sequence[Column]], tuple[Column, Column]]
) -> PartType:
    """Returns the type of straight links of a module type. `both`: K and B/T, by the live columns."""
    lives = len(module.live)

    def constants(links: Iterable[Any], context: BuildContext) -> tuple[Column, Column]:
        lengths = [getattr(link, "length", None) or 0.0 for link in links]
        return context.column(lengths), near_of(lengths, context)

    def numbers(ends: Ends, *columns: Column) -> PlaneLinks:
        length, *directions = columns[lives:]
        return PlaneLinks(ends, *both(columns[:lives]), length, Directions(*directions))

    return link_type(
        module, numbers, add_forces, name, _REMEMBERED,
        constants=constants, remembers=3, initialize=initialize, space=2,
    )  # fmt: skip


def _plectra(ends: Ends, stiffness: Column, damping: Column, release: Column, *rest: Column) -> PlanePlectra:
    *directions, side = rest
    return PlanePlectra(ends, stiffness, damping, release, Directions(*directions), side)


def _laws(links: Mapping[str, Link]) -> dict[str, Law]:
    return {name: law for name, link in links.items() if (law := link.table()) is not None}


def _with_knots(scene: Scene) -> dict[str, Link]:
    links = scene.plane_links
    return {name: links[name] for name in _laws(links)}


def _live_knots(links: Mapping[str, Link], rate: float) -> list[LiveColumn]:
    return knot_columns(_laws(links), rate, 1.0, "")


def _tables(links: Mapping[str, Link], columns: Sequence[Column], context: BuildContext) -> Part:
    near = near_of((getattr(link, "distance", 0.0) for link in links.values()), context)
    remembered = tuple(np.zeros((3, near.size), context.real))
    table = table_numbers(links, list(_laws(links).values()), columns, context)
    return Part(
        PlaneTables(table, Directions(near, *remembered)),
        initialize=initialize_tables,
        retarget=retarget_tables,
        add_forces=add_table_forces,
        memory=Memory(tuple(links), remembered),
    )


_REMEMBERED = "a direction each"

PLANE_VISCOELASTIC = _straight_type(ViscoElastic, "visco-elastic links in the plane", lambda both: (both[0], both[1]))
PLANE_SPRING = _straight_type(Spring, "springs in the plane", lambda live: (live[0], np.zeros_like(live[0])))
PLANE_DAMPER = _straight_type(Damper, "dampers in the plane", lambda live: (np.zeros_like(live[0]), live[0]))
PLANE_TABLES = PartType(
    _with_knots,
    _tables,
    name="contacts, curves and clicks in the plane",
    compiled_as=f"a search in each one's knots; {_REMEMBERED}",
    live=_live_knots,
)
PLANE_PLECTRUM = link_type(
    Plectrum, _plectra, add_plectrum_forces, "plectra in the plane", f"a grip and {_REMEMBERED}",
    constants=lambda links, context: (near_of((0.0 for _ in links), context),),
    remembers=4, initialize=initialize, space=2,
)  # fmt: skip
PLANE_FRICTION = link_type(
    Friction, PlaneFrictions, add_friction_forces, "friction links in the plane", "an anchor each",
    remembers=3, initialize=initialize_friction, space=2,
)  # fmt: skip
