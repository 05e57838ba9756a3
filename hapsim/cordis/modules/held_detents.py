"""The detent that holds: a memory of the place in which its ends are, one recurrence for a pitch and for places.

With its place k, which rests at r, u = d - r and z the dead zone, the next place takes over where u exceeds its share
of the way to it, and the one before likewise. In the place that results

    F[n] = K (u - clip(u, -z, z)) + (B/T) (d[n] - d[n-1]),       K = depth/(hold_until p - z) on the side of the way p

Beyond the first and the last of its places K is that of the stops. Each change of a place is noted in a ring, for
programs that watch it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory, action
from hapsim.cordis.line_query import COLLECTS, X, add_force, add_knot, far_end, side_of
from hapsim.cordis.modules.link import Ends, count, ends_of, pull_ends, stretch
from hapsim.scene import Detent

MOST_CHANGES = 4096
"""Changes of places that a batch keeps: some seconds of the fastest hand."""


class HeldDetents(NamedTuple):
    """L detents and their places, P in all, one detent's behind the other's; with a pitch it has one, number 0.

    Attributes:
        begin: (L + 1,) first place of each.
        rest, holds: (P,) m, and 1 where a place holds, else 0.
        low, high: (P,) m from the rest, where the place before and the next one take over.
        below, above: (P,) N/m on both sides of the rest.
        changes: (MOST_CHANGES, 3) step, number of the link, and its new place; a ring.
        counts: steps so far, and changes.
        pitch, depth, damping_per_sample, dead_zone, hold, stop: (L,) m, N, N/m, m, share, N/m below 0 for none; live.
        place: (L,) number of the place in which the ends are.
    """

    ends: Ends
    begin: NDArray[np.uint64]
    rest: Column
    holds: Column
    low: Column
    high: Column
    below: Column
    above: Column
    changes: NDArray[np.int64]
    counts: NDArray[np.int64]
    pitch: Column
    depth: Column
    damping_per_sample: Column
    dead_zone: Column
    hold: Column
    stop: Column
    place: Column


@action
def retarget(links, _state):
    """Computes the numbers that depend on the live ones."""
    _update(value_of(links))


@inlined
def _update(links):
    real = links.rest.dtype.type
    for i in range(count(links.ends)):
        first, last, pitch = links.begin[i], links.begin[i + ONE] - ONE, links.pitch[i]
        for k in range(first, last + ONE):
            before = pitch if pitch > 0 or k == first else links.rest[k] - links.rest[k - ONE]
            after = pitch if pitch > 0 or k == last else links.rest[k + ONE] - links.rest[k]
            links.below[k], links.above[k] = _flank(links, i, before), _flank(links, i, after)
            links.low[k] = -links.hold[i] * before if before > 0 else real(-np.inf)
            links.high[k] = links.hold[i] * after if after > 0 else real(np.inf)
            if not before > 0:
                links.below[k] = links.stop[i] if links.stop[i] >= 0 else links.above[k]
            if not after > 0:
                links.above[k] = links.stop[i] if links.stop[i] >= 0 else links.below[k]
            if links.holds[k] == 0:  # the stops hold in any case
                links.below[k] = links.below[k] if not before > 0 else real(0)
                links.above[k] = links.above[k] if not after > 0 else real(0)


@inlined
def _flank(links, i, way):
    """Returns K of link i on the side of a way in m, N/m; 0 without one."""
    reach = links.hold[i] * way - links.dead_zone[i]
    return links.depth[i] / reach if reach > 0 and way > 0 else links.rest.dtype.type(0)


@action
def initialize(links, state):
    """Puts every link into the place that is nearest to it."""
    links, state = value_of(links), value_of(state)
    _update(links)
    for i in range(count(links.ends)):
        d, first, pitch = stretch(links.ends, i, state.position), links.begin[i], links.pitch[i]
        links.place[i] = 0
        if pitch > 0:
            links.place[i] = np.floor(d / pitch + links.rest.dtype.type(0.5))
        for k in range(first + ONE, links.begin[i + ONE]):
            if d - links.rest[k - ONE] > links.rest[k] - d:
                links.place[i] = k - first


@action
def add_forces(links, state):
    """Adds the force of every link, in the place that holds it now."""
    links, state = value_of(links), value_of(state)
    for i in range(count(links.ends)):
        d = stretch(links.ends, i, state.position)
        growth = d - stretch(links.ends, i, state.previous)
        before = links.place[i]
        _move_on(links, i, d)
        if links.place[i] != before:
            at = np.uint64(links.counts[1] % MOST_CHANGES)
            links.changes[at, 0], links.changes[at, 1] = links.counts[0], np.int64(i)
            links.changes[at, 2] = np.int64(links.place[i])
            links.counts[1] += 1
        tension, _ = _held(links, i, d)
        pull_ends(links.ends, i, tension + links.damping_per_sample[i] * growth, state.force)
    links.counts[0] += 1


@inlined
def _move_on(links, i, d):
    """Moves link i on to the place that holds it at `d` m."""
    pitch, k = links.pitch[i], _place(links, i)
    if pitch > 0:
        u = d - pitch * links.place[i]
        if u > links.high[k]:
            links.place[i] = np.ceil(d / pitch - links.hold[i])
        elif u < links.low[k]:
            links.place[i] = np.floor(d / pitch + links.hold[i])
        return
    while d - links.rest[k] > links.high[k]:
        k += ONE
    while d - links.rest[k] < links.low[k]:
        k -= ONE
    links.place[i] = k - links.begin[i]


@inlined
def _place(links, i):
    """Returns the index of link i's place; that of another list of places may be beyond the last one."""
    begin, last = links.begin[i], links.begin[i + ONE] - ONE
    return begin if links.pitch[i] > 0 else min(begin + np.uint64(max(links.place[i], 0)), last)


@inlined
def _held(links, i, d):
    """Returns link i's tension in N at `d` m in its place, NaN for NaN, without its damper; its slope there in N/m."""
    k, free = _place(links, i), links.dead_zone[i]
    u = d - (links.rest[k] + links.pitch[i] * links.place[i])
    bent = u + free if u < -free else u - free if u > free else u - u
    slope = links.below[k] if bent < 0 else links.above[k]
    return slope * bent, slope if bent != 0 or free == 0 else links.rest.dtype.type(0)


@action
def add_to_line(held, query):
    """Adds every such detent of a hand to its line: the place that holds it goes on until the next line."""
    held, query = value_of(held), value_of(query)
    links, real = held.links, held.links.rest.dtype.type
    for j in range(np.uint64(held.held.size)):
        i = held.held[j]
        side = side_of(query, links.ends, i)
        if side != 0.0:
            place, way = far_end(query, links.ends, i, side)
            if query.whole[COLLECTS]:
                rest = np.float64(links.rest[_place(links, i)] + links.pitch[i] * links.place[i])
                add_knot(query.whole, query.knots, place + side * (rest - np.float64(links.dead_zone[i])))
                add_knot(query.whole, query.knots, place + side * (rest + np.float64(links.dead_zone[i])))
            else:
                tension, slope = _held(links, i, real(side * (query.numbers[X] - place)))
                add_force(query, side, way, tension, slope, links.damping_per_sample[i], False)


def _build(links: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    begin = np.cumsum([0, *(len(one.rests) for one in links.values())]).astype(np.uint64)
    rest, holds = (
        context.column([x for one in links.values() for x in getattr(one, what)]) for what in ("rests", "holding")
    )
    pitch, depth, damping, _, dead_zone, hold, stop = columns
    low, high, below, above = np.zeros((4, int(begin[-1])), context.real)
    changes, counts, place = np.zeros((MOST_CHANGES, 3), np.int64), np.zeros(2, np.int64), context.column(begin[1:] * 0)
    numbers = HeldDetents(
        *(ends_of(links, context), begin, rest, holds, low, high, below, above, changes, counts),
        *(pitch, depth, damping, dead_zone, hold, stop, place),
    )
    memory = Memory(tuple(links), {"place": place})
    return Batch(numbers, initialize=initialize, retarget=retarget, add_forces=add_forces, memory=memory)


HELD = BatchType(
    all_of(Detent, lambda detent: detent.is_held),
    _build,
    name="detents that hold",
    compiled_as="gathered through unsigned indices; a place each",
    line=add_to_line,
)
