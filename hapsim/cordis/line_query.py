"""The knots of the links at a hand, and their law at a place: their side of its line (`law: board`, `board_line.py`).

A batch's action `line` has one way to be asked: it adds the knots of its links, or what they do at the asked place.
Masses, strings and other hands stand where the host knows them for the next sample.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import ONE
from hapsim.compiling import inlined
from hapsim.cordis.dispatch import Column

MOST_KNOTS = 256  # of a hand
MOST_OF_LINK = 64  # one with more in reach skips periods, or knots

# Numbers of a query: the asked place, the ends of the hand's reach, the weight of the program; the sums at the place.
X, FROM, UNTIL, WEIGHT, FORCE, SLOPE, DAMPING, DRIFT, FREE_DAMPING, FREE_DRIFT = range(10)
HANDS = 16  # then the place of each hand, m, and its way in a step, m
WAYS = HANDS + schema.MAX_CHANNELS
QUERY_NUMBERS = WAYS + schema.MAX_CHANNELS
HAND, TURN, COLLECTS, COUNT, QUERY_WHOLE = range(5)


class LineQuery(NamedTuple):
    """A hand's question to its links: the positions of a program, (2, N) m, and the numbers above. `knots`: m, by
    ascending place."""

    rows: Column
    hands: np.uint64
    numbers: NDArray[np.float64]
    whole: NDArray[np.int64]
    knots: NDArray[np.float64]


class HeldLinks(NamedTuple):
    """The links of a batch, and the numbers of those that end on a hand."""

    links: Any
    held: NDArray[np.uint64]


def held_links(links: Any, hands: int) -> HeldLinks:
    """Returns these links with the numbers of those that end on one of the first `hands` points."""
    ends = links.ends
    return HeldLinks(links, np.flatnonzero((ends.first < hands) | (ends.second < hands)).astype(np.uint64))


def line_query(rows: Column, hands: int) -> LineQuery:
    """Returns the query of a program with these positions."""
    numbers, whole = np.zeros(QUERY_NUMBERS), np.zeros(QUERY_WHOLE, np.int64)
    return LineQuery(rows, np.uint64(hands), numbers, whole, np.zeros(MOST_KNOTS))


@inlined
def side_of(query, ends, i):
    """Returns 1.0 if the asking hand is link i's first end, -1.0 if its second, 0.0 if it is neither."""
    hand = np.uint64(query.whole[HAND])
    return 1.0 if ends.first[i] == hand else -1.0 if ends.second[i] == hand else 0.0


@inlined
def far_end(query, ends, i, side):
    """Returns the place of link i's other end at the next sample, m, and its way there in a step, m."""
    point = np.uint64(ends.second[i]) if side > 0.0 else np.uint64(ends.first[i])
    if point < query.hands:
        return query.numbers[np.uint64(HANDS) + point], query.numbers[np.uint64(WAYS) + point]
    turn = np.uint64(query.whole[TURN])
    place = np.float64(query.rows[turn, point])
    return place, place - np.float64(query.rows[ONE - turn, point])


@inlined
def add_spring_and_damper(query, ends, i, stiffness, damping):
    """Adds link i, a spring in N/m and a damper that act everywhere. `damping`: N/m, B over the period of a step."""
    side = side_of(query, ends, i)
    if side != 0.0 and not query.whole[COLLECTS]:
        place, way = far_end(query, ends, i, side)
        d = side * (query.numbers[X] - place)
        add_force(query, side, way, stiffness * d, stiffness, damping, False)


@inlined
def add_spring_between(query, ends, i, spring, span, beyond):
    """Adds link i, a spring of N/m with a damper of N/m that rests at a stretch, m, from one stretch to another, m;
    outside them it has constant tensions, N, and no damper. `spring`, `span`, `beyond`: these numbers."""
    side = side_of(query, ends, i)
    if side != 0.0:
        place, way = far_end(query, ends, i, side)
        d, (stiffness, damping, rest) = side * (query.numbers[X] - place), spring
        if query.whole[COLLECTS]:
            add_knot(query.whole, query.knots, place + side * span[0])
            add_knot(query.whole, query.knots, place + side * span[1])
        elif span[0] <= d <= span[1]:
            add_force(query, side, way, stiffness * (d - rest), stiffness, damping, True)
        else:
            add_force(query, side, way, beyond[0] if d < span[0] else beyond[1], 0.0, 0.0, True)


@inlined
def add_force(query, side, way, tension, slope, damping, pushes):
    """Adds what a link does at the asked place: its tension in N, its slope and damping in N/m. `way`: of its other
    end. `pushes`: it is a contact."""
    numbers = query.numbers
    weight = numbers[WEIGHT]
    numbers[FORCE] -= weight * side * tension
    numbers[SLOPE] += weight * slope
    numbers[DAMPING] += weight * damping
    numbers[DRIFT] += weight * damping * way
    if not pushes:
        numbers[FREE_DAMPING] += weight * damping
        numbers[FREE_DRIFT] += weight * damping * way


@inlined
def add_knot(whole, knots, x):
    """Adds a knot of the law at x m, once, in order, while there is room."""
    at = np.uint64(whole[COUNT])
    while at > 0 and knots[at - ONE] > x:
        at -= ONE
    if whole[COUNT] == MOST_KNOTS or (at > 0 and knots[at - ONE] == x):
        return
    for after in range(np.uint64(whole[COUNT]), at, -1):
        knots[np.uint64(after)] = knots[np.uint64(after) - ONE]
    knots[at] = x
    whole[COUNT] += 1
