"""The links that are straight between knots: buffer (CORDIS: BUT), curve over distance (LNL), snap and notch detents,
click; and the curve over velocity. The class of a link in scene/modules says where its knots are.

With the last knot (d_k, F_k) at or below d, and z the damping from there on,

    F[n] = F_k + (d[n] - d_k) (F_k+1 - F_k)/(d_k+1 - d_k) + (z/T) (d[n] - d[n-1])

Below the first knot and above the last the law has slopes of its own, unless it repeats. What only pushes never pulls
more than its knots do: a damper would hold back what leaves. All numbers are live: between two laws of as many knots,
those in between are laws too, whose edges stay in order and whose slopes lie between those of both.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import BuildContext, LiveColumn, PartType, knot_field
from hapsim.cordis.dispatch import Column, Part, action
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.laws import Law, curve_law, roomy
from hapsim.scene import Nonlinear, Scene
from hapsim.scene.modules import Link


class TableLinks(NamedTuple):
    """L links and their knots, K in all, one link's behind the other's: link i has those from begin[i] to before
    begin[i + 1].

    Attributes:
        piece: (L,) the knot whose piece was found the last time.
        pushes: (L,) 1 where the tension never exceeds the highest of the knots, or 0.
        slope, until: (K,) N/m from each knot on, and where it ends, m.
        most: (L,) N, which the tension never exceeds.
        nothing_from: (L,) m, from which on there is no force.
        turn: (L,) m, of how many periods that piece is in another than the first.
        edge, tension, damping_per_sample: (K,) m, N, and N/m from there on; live, as all that follow.
        below, damping_below, beyond: (L,) N/m, slopes below the first knot and above the last; B/T below the first.
        period: (L,) m; 0: it does not repeat.
    """

    ends: Ends
    begin: NDArray[np.uint64]
    piece: NDArray[np.uint64]
    pushes: NDArray[np.uint8]
    slope: Column
    until: Column
    most: Column
    nothing_from: Column
    turn: Column
    edge: Column
    tension: Column
    damping_per_sample: Column
    below: Column
    damping_below: Column
    beyond: Column
    period: Column


@action
def retarget(links, _state):
    """Works out what follows from the live numbers."""
    links = value_of(links)
    real = links.edge.dtype.type
    for i in range(count(links.ends)):
        first, last, period = links.begin[i], links.begin[i + ONE] - ONE, links.period[i]
        for k in range(first, last):
            links.slope[k], links.until[k] = _slope(links, k, k + ONE, real(0)), links.edge[k + ONE]
        links.until[last] = links.edge[first] + period if period > 0 else real(np.inf)
        links.slope[last] = _slope(links, last, first, period) if period > 0 else links.beyond[i]
        is_nothing = links.slope[last] == 0 and links.tension[last] == 0 and links.damping_per_sample[last] == 0
        links.nothing_from[i] = links.edge[last] if is_nothing and not period > 0 else real(np.inf)
        links.turn[i] = real(0)
        links.most[i] = real(0) if links.pushes[i] else real(np.inf)
        for k in range(first, last + ONE):
            links.most[i] = max(links.most[i], links.tension[k])


@inlined
def _slope(links, knot, following, turn):
    """From one knot to another, which is `turn` further on; 0 where both are at one place."""
    width = links.edge[following] + turn - links.edge[knot]
    rise = links.tension[following] - links.tension[knot]
    return rise / width if width > 0 else links.edge.dtype.type(0)


@action
def add_table_forces(links, state):
    """Adds what every link does for the distance of its ends."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        if not d >= links.nothing_from[i]:
            pull_ends(links.ends, i, _tension_at(links, i, d, state.previous), state.force)


@action
def add_velocity_forces(links, state):
    """Adds what every link does for how fast its ends part."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        growth = stretch(links.ends, i, state.position) - stretch(links.ends, i, state.previous)
        pull_ends(links.ends, i, _tension_at(links, i, growth, state.previous), state.force)


@inlined
def _tension_at(links, i, d, previous):
    """Link i's tension at `d` m, where its points were at `previous` a sample before; NaN for NaN."""
    k, at = links.piece[i], d - links.turn[i]
    slope, damping = links.slope[k], links.damping_per_sample[k]
    if not links.edge[k] <= at < links.until[k]:  # else it is where it was the last time, as mostly
        k, period, at = links.begin[i], links.period[i], d
        if period > 0:
            links.turn[i] = period * np.floor((d - links.edge[k]) / period)
            at -= links.turn[i]
        slope, damping = links.below[i], links.damping_below[i]
        if not at < links.edge[k]:
            k = links.piece[i] = _piece(links, k, links.begin[i + ONE], at)
            slope, damping = links.slope[k], links.damping_per_sample[k]
    tension = links.tension[k] + slope * (at - links.edge[k])
    if damping != 0:
        tension += damping * (d - stretch(links.ends, i, previous))
    return min(tension, links.most[i])


@inlined
def _piece(links, k, end, at):
    """The last knot at or below `at`, of those from `k`, which is, to before `end`."""
    while end - k > ONE:
        middle = (k + end) >> ONE
        if at < links.edge[middle]:
            end = middle
        else:
            k = middle
    return k


def _columns(laws: Mapping[str, Law], rate: float, per: float, over: str) -> list[LiveColumn]:
    """The live columns of `TableLinks`; `per`: metres in a unit of the laws' edges, which are `over` that."""

    def of_knots(what: str, values: Callable[[Law], Sequence[float]]) -> LiveColumn:
        rows = {name: values(law)[-len(law.knots) :] for name, law in laws.items()}
        return {
            knot_field(over + what, name, k, len(row)): one for name, row in rows.items() for k, one in enumerate(row)
        }

    def of_laws(what: str, value: Callable[[Law], float]) -> LiveColumn:
        return {(name, over + what): value(law) for name, law in laws.items()}

    return [
        of_knots("edge", lambda law: [at * per for at, _ in law.knots]),
        of_knots("tension", lambda law: [tension for _, tension in law.knots]),
        of_knots("damping", lambda law: [damping * rate for damping in law.dampings]),
        of_laws("below", lambda law: law.below),
        of_laws("damping below", lambda law: law.dampings[-1 if law.period else 0] * rate),
        of_laws("beyond", lambda law: law.beyond),
        of_laws("period", lambda law: law.period),
    ]


def _table_type(
    table: Callable[[Any], Law | None],
    add_forces: NativeFunction,
    name: str,
    per: Callable[[float], float] = lambda _: 1.0,
    over: str = "",
) -> PartType:
    """The links that have this table, whose edges are in `per` metres at a rate in Hz; `over`: as of `_columns`."""

    def tables(links: Mapping[str, Link]) -> dict[str, Law]:
        return {name: law for name, link in links.items() if (law := table(link)) is not None}

    def select(scene: Scene) -> dict[str, Link]:
        return {name: scene.links[name] for name in tables(scene.links)}

    def live(links: Mapping[str, Link], rate: float) -> list[LiveColumn]:
        return _columns(tables(links), rate, per(rate), over)

    def build(links: Mapping[str, Link], columns: Sequence[Column], context: BuildContext) -> Part:
        laws = tables(links).values()
        begin = np.cumsum([0, *(len(law.knots) for law in laws)]).astype(np.uint64)
        pushes = np.array([law.pushes for law in laws], np.uint8)
        derived = *np.zeros((2, int(begin[-1])), context.real), *np.zeros((3, len(laws)), context.real)
        numbers = TableLinks(ends_of(links, context), begin, begin[:-1].copy(), pushes, *derived, *columns)
        return Part(numbers, initialize=retarget, retarget=retarget, add_forces=add_forces)

    words = "gathered through unsigned indices; a search in each one's knots"
    return PartType(select, build, name=name, compiled_as=words, live=live)


def _over_velocity(link: Link) -> Law | None:
    points = link.force_over_velocity if isinstance(link, Nonlinear) else None
    return None if points is None else roomy(curve_law(points))


def over_common_edges(
    scene: Scene, places: Mapping[tuple[str, str], int], live: Column, posted: tuple[Column, Column], wanted: Column
) -> Column | None:
    """Writes each table of `wanted` over edges of the one before it too, so that a ramp from that is one of forces.

    Args:
        places: of live values; `live`: what they are now.
        posted: those that the scene had before, as `parameter_values` has them and as they were posted.
        wanted: those of `scene`, to be posted: written over.

    Returns:
        What the live values first become, without another force, NaN where they stay; None where a table is still on
        its way to one of other points.
    """
    begins = np.full(wanted.size, np.nan)
    for (name, what), first in places.items():
        if not isinstance(scene.modules.get(name), Nonlinear) or "edge 0 of" not in what:
            continue
        size, rise = int(what.split()[-1]), places[name, what.replace("edge", "tension")]
        at, force = slice(first, first + size), slice(rise, rise + size)
        edges = posted[1][at]
        if not np.isin(wanted[at], edges).all():
            if any(not np.array_equal(live[which], posted[1][which]) for which in (at, force)):
                return None
            edges = np.unique([posted[0][at], wanted[at]])
            edges = np.pad(edges, (0, size - edges.size), mode="edge")
            begins[at], begins[force] = edges, np.interp(edges, posted[0][at], posted[0][force])
        wanted[force] = np.interp(edges, wanted[at], wanted[force])
        wanted[at] = edges
    return begins


TABLES = _table_type(lambda link: link.table(), add_table_forces, "contacts, curves, detents and clicks")
VELOCITY_TABLES = _table_type(
    _over_velocity, add_velocity_forces, "forces over velocity", lambda rate: 1.0 / rate, "growth: "
)
