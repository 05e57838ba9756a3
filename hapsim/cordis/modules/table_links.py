"""The links that are straight between knots: buffer (CORDIS: BUT), curve over distance (LNL), snap and notch detents,
click; and the curve over velocity. The class of a link in scene/modules says where its knots are.

With the last knot (d_k, F_k) at or below d, and z the damping from there on,

    F[n] = F_k + (d[n] - d_k) (F_k+1 - F_k)/(d_k+1 - d_k) + (z/T) (d[n] - d[n-1])

Below the first knot and above the last the law has slopes of its own, unless it repeats. A link that only pushes never
pulls more than its knots do: its damper would hold back a leaving hand. All numbers are live: between two laws with as
many knots, the interpolated ones are laws too, with edges in order and slopes between those of both.

A curve with two branches has two such tables, the mean M of its branches and half their difference h, and an anchor w
that is never further than `reach` = turn/2 from d:

    F[n] = M(d[n]) + h(d[n]) z[n]        z[n] = (d[n] - w)/reach, from -1 (release) to 1 (press)
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.build_context import OF_SLIDER, BatchType, BuildContext, LiveColumn, all_of, knot_field
from hapsim.cordis.dispatch import Batch, Column, Memory, action
from hapsim.cordis.line_query import COLLECTS, FROM, MOST_OF_LINK, UNTIL, X, add_force, add_knot, far_end, side_of
from hapsim.cordis.modules.link import Ends, apart_from_proxies, count, ends_of, pull_ends, stretch
from hapsim.laws import Law, curve_law
from hapsim.scene import Nonlinear, Scene
from hapsim.scene.modules import Link


class TableLinks(NamedTuple):
    """L links and their knots, K in all, one link's behind the other's: link i has those from begin[i] to before
    begin[i + 1].

    Attributes:
        piece: (L,) the knot of the last used piece.
        pushes: (L,) 1 if the tension never exceeds the highest of the knots, else 0.
        slope, until: (K,) N/m from each knot on, and its end, m.
        most: (L,) N, largest tension.
        nothing_from: (L,) m, beyond which there is no force.
        turn: (L,) m, offset of that piece's period from the first.
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
    """Computes the numbers that depend on the live ones."""
    update_pieces(value_of(links))


@inlined
def update_pieces(links):
    """Computes the numbers that depend on the live ones."""
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
    """Returns the slope from one knot to another, which is `turn` further on; 0 if both are at one place."""
    width = links.edge[following] + turn - links.edge[knot]
    rise = links.tension[following] - links.tension[knot]
    return rise / width if width > 0 else links.edge.dtype.type(0)


@action
def add_table_forces(links, state):
    """Adds the force of every link, by the distance of its ends."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        if not d >= links.nothing_from[i]:
            pull_ends(links.ends, i, tension_at(links, i, d, state.previous)[0], state.force)


class BranchLinks(NamedTuple):
    """L links with two branches: the tables M and h; shape (L,): `reach` and `anchor` in m."""

    mean: TableLinks
    half: TableLinks
    reach: Column
    anchor: Column


@action
def initialize_branches(links, state):
    """Begins in the middle between the branches."""
    links, state = value_of(links), value_of(state)
    update_pieces(links.mean)
    update_pieces(links.half)
    for i in range(count(links.mean.ends)):
        links.anchor[i] = stretch(links.mean.ends, i, state.position)


@action
def add_branch_forces(links, state):
    """Adds the force of every link with two branches."""
    links, state = value_of(links), value_of(state)
    ends, real = links.mean.ends, links.reach.dtype.type
    for i in range(count(ends)):
        d, reach = stretch(ends, i, state.position), links.reach[i]
        z = (d - links.anchor[i]) / reach
        if abs(z) > 1:
            z = real(1) if z > 0 else real(-1)
            links.anchor[i] = d - z * reach
        pull_ends(ends, i, law_at(links.mean, i, d)[0] + law_at(links.half, i, d)[0] * z, state.force)


@action
def add_velocity_forces(links, state):
    """Adds the force of every link, by the velocity of its ends."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        growth = stretch(links.ends, i, state.position) - stretch(links.ends, i, state.previous)
        pull_ends(links.ends, i, tension_at(links, i, growth, state.previous)[0], state.force)


@action
def add_tables_to_line(held, query):
    """Adds every link of a hand to the line of that hand: its knots in reach, or its law at the asked place."""
    held, query = value_of(held), value_of(query)
    links, numbers, real = held.links, query.numbers, held.links.edge.dtype.type
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        side = side_of(query, links.ends, i)
        if side != 0.0:
            place, way = far_end(query, links.ends, i, side)
            if query.whole[COLLECTS]:
                ends = side * (numbers[FROM] - place), side * (numbers[UNTIL] - place)
                _add_knots(query, links, i, side, place, min(ends[0], ends[1]), max(ends[0], ends[1]))
            else:
                tension, slope, damping = law_at(links, i, real(side * (numbers[X] - place)))
                add_force(query, side, way, tension, slope, damping, links.pushes[i])


@inlined
def _add_knots(query, links, i, side, place, low, high):
    """Adds the knots of link i between `low` and `high` m, with the next on both sides. If these are many, it skips
    periods, or knots of a law that does not repeat."""
    first, end, period, turn = links.begin[i], links.begin[i + ONE], np.float64(links.period[i]), 0.0
    if period > 0:
        turn = period * np.floor((low - links.edge[first]) / period)
    k = first if low < links.edge[first] else _piece(links, first, end, low - turn)
    skipped = np.uint64(0)
    if period > 0:
        every = period * (1.0 + np.floor((high - low) / period * (end - first) / MOST_OF_LINK))
    else:
        beyond = min(high, np.float64(links.edge[end - ONE]))  # roomy laws repeat their last knot
        while end - k > ONE and links.edge[end - ONE - ONE] >= beyond:
            end -= ONE
        skipped = (end - k) // np.uint64(MOST_OF_LINK)
    while k < end:
        x = links.edge[k] + turn
        add_knot(query.whole, query.knots, place + side * x)
        if not x <= high:
            break
        k += ONE + skipped
        if k == end and period > 0:
            k, turn = first, turn + every


@inlined
def tension_at(links, i, d, previous):
    """Returns link i's tension in N at `d` m, with its points at `previous` a sample before, NaN for NaN; and its
    slope there in N/m, in which the damper has its part."""
    tension, slope, damping = law_at(links, i, d)
    if damping != 0:
        tension += damping * (d - stretch(links.ends, i, previous))
        slope += damping
    return min(tension, links.most[i]), links.edge.dtype.type(0) if tension > links.most[i] else slope


@inlined
def law_at(links, i, d):
    """Returns link i's tension in N at `d` m, NaN for NaN, without its damper; its slope there in N/m, and its B/T."""
    k, at = links.piece[i], d - links.turn[i]
    slope, damping = links.slope[k], links.damping_per_sample[k]
    if not links.edge[k] <= at < links.until[k]:  # usually the piece is the last one
        k, period, at = links.begin[i], links.period[i], d
        if period > 0:
            links.turn[i] = period * np.floor((d - links.edge[k]) / period)
            at -= links.turn[i]
        slope, damping = links.below[i], links.damping_below[i]
        if not at < links.edge[k]:
            k = links.piece[i] = _piece(links, k, links.begin[i + ONE], at)
            slope, damping = links.slope[k], links.damping_per_sample[k]
    return links.tension[k] + slope * (at - links.edge[k]), slope, damping


@inlined
def _piece(links, k, end, at):
    """Returns the last knot at or below `at`, from `k` to before `end`; knot `k` is."""
    while end - k > ONE:
        middle = (k + end) >> ONE
        if at < links.edge[middle]:
            end = middle
        else:
            k = middle
    return k


def knot_columns(laws: Mapping[str, Law], rate: float, per: float, over: str) -> list[LiveColumn]:
    """Returns the live columns of `TableLinks`. `per`: metres per unit of edges; `over`: prefix of the field names."""

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


def _laws(links: Mapping[str, Link], table: Callable[[Any], Law | None]) -> dict[str, Law]:
    return {name: law for name, link in links.items() if (law := table(link)) is not None}


def table_type(
    table: Callable[[Any], Law | None],
    batch: Callable[[TableLinks, Mapping[str, Any], BuildContext], Batch],
    name: str,
    per: Callable[[float], float] = lambda _: 1.0,
    over: str = "",
    links_of: Callable[[Scene], Mapping[str, Link]] = lambda scene: scene.links,
    words: str = "gathered through unsigned indices; a search in each one's knots",
    line: NativeFunction | None = None,
) -> BatchType:
    """Returns the type of those links of a scene that have this table. `batch`: makes their batch of their numbers;
    `per`: metres per unit of edges, at a rate in Hz; `over`: prefix."""

    def select(scene: Scene) -> dict[str, Link]:
        links = links_of(scene)
        return apart_from_proxies({name: links[name] for name in _laws(links, table)}, scene)

    def live(links: Mapping[str, Link], rate: float) -> list[LiveColumn]:
        return knot_columns(_laws(links, table), rate, per(rate), over)

    def build(links: Mapping[str, Link], columns: Sequence[Column], context: BuildContext) -> Batch:
        return batch(table_numbers(links, list(_laws(links, table).values()), columns, context), links, context)

    return BatchType(select, build, name=name, compiled_as=words, live=live, line=line)


def _batch_with(add_forces: NativeFunction) -> Callable[..., Batch]:
    return lambda numbers, *_: Batch(numbers, initialize=retarget, retarget=retarget, add_forces=add_forces)


def table_numbers(
    links: Mapping[str, Link], laws: Sequence[Law], columns: Sequence[Column], context: BuildContext
) -> TableLinks:
    """Returns the numbers of links with these laws."""
    begin = np.cumsum([0, *(len(law.knots) for law in laws)]).astype(np.uint64)
    pushes = np.array([law.pushes for law in laws], np.uint8)
    derived = *np.zeros((2, int(begin[-1])), context.real), *np.zeros((3, len(laws)), context.real)
    return TableLinks(ends_of(links, context), begin, begin[:-1].copy(), pushes, *derived, *columns)


def _over_velocity(link: Link) -> Law | None:
    points = link.force_over_velocity if isinstance(link, Nonlinear) else None
    return None if points is None else curve_law(points)


def _with_branches() -> BatchType:
    """Returns the type of the curves with two branches. Their numbers do not ramp: such a curve crossfades."""
    tables: tuple[Callable[[Any], Law | None], ...] = Nonlinear.table, Nonlinear.slider

    def live(links: Mapping[str, Nonlinear], rate: float) -> list[LiveColumn]:
        mean, half = (_laws(links, table) for table in tables)
        reach = {(name, "reach"): link.law().reach for name, link in links.items()}
        return [*knot_columns(mean, rate, 1.0, ""), *knot_columns(half, rate, 1.0, OF_SLIDER), reach]

    def build(links: Mapping[str, Nonlinear], columns: Sequence[Column], context: BuildContext) -> Batch:
        middle, anchor = len(columns) // 2, np.zeros(len(links), context.real)
        mean, half = (
            table_numbers(links, [*_laws(links, table).values()], own, context)
            for table, own in zip(tables, (columns[:middle], columns[middle:-1]), strict=True)
        )
        memory = Memory(tuple(links), {"anchor": anchor})
        numbers = BranchLinks(mean, half, columns[-1], anchor)
        return Batch(numbers, initialize_branches, add_forces=add_branch_forces, memory=memory)

    words = "gathered through unsigned indices; a search in the knots of mean and half difference each"
    every = all_of(Nonlinear, lambda link: link.branches is not None)
    return BatchType(every, build, name="curves with two branches", compiled_as=words, live=live)


BRANCHES = _with_branches()
TABLES = table_type(
    lambda link: None if link.slider() else link.table(),
    _batch_with(add_table_forces),
    "contacts, curves, detents and clicks",
    line=add_tables_to_line,
)
VELOCITY_TABLES = table_type(
    _over_velocity, _batch_with(add_velocity_forces), "forces over velocity", lambda rate: 1.0 / rate, "growth: "
)
