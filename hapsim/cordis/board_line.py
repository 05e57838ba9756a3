"""The line of a hand: along which the board changes its force until the next sample, under `law: board`.

    f = F + k (x_n - x) - b v, clipped to low ... high; at a bound f is that bound, whatever v

F is the force of the links on the hand at x_n, without the hand's own damping. With v the hand's speed in the last
sample period, the line acts from x_a, `lead` samples ahead, to x_b, a sample on. x_m is the middle of that stretch.

* The line is the tangent of the law at x_m. Where the stretch meets a piece of the law that is narrower than itself,
  the chord from x_a to x_b replaces the tangent, if the law leaves the chord by at most DEVIATION of its range and the
  chord resists. Otherwise the line is the tangent at x_a where that resists, and k is 0 where it does not. A force that
  is held across narrow pieces pushes where it should brake; a tangent that goes on too far brakes, within the bounds.
* Where the hand is in a stiffer piece than x_m, and that resists, the tangent is that of the hand's piece: a stiff hand
  turns sooner than at its speed, and a line that leaves the piece before the hand does pushes too little.
* `low` and `high` are the extremes of the law over every place that the hand can reach until the line ends, and over
  the tangent's piece: no line gives a force that the law does not have there. A damper that acts everywhere widens
  them by its force at the fastest motion; that of a contact does not, so that it never pulls.
* Where the tangent's piece is flat and a bound, and a sloping piece is within reach, the line is that of the sloping
  piece: a contact is made and left between two samples.

The law is that of all links of the hand together, and during a crossfade of both scenes.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol.compiled import ONE
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import array_at
from hapsim.cordis import line_query as query
from hapsim.cordis.dispatch import call_all
from hapsim.cordis.line_query import add_knot
from hapsim.cordis.tick import program_at

DEVIATION = 0.1
_FLAT = 1e-9  # of the law's range over the reach
_INSIDE = 1e-7  # of a piece's width: so far from a knot the law is that of this side

LAW = np.dtype(
    [
        ("programs", np.uint64, (2,)),  # addresses; 0: none
        ("weights", np.float64, (2,)),
        ("force", np.float64),  # N, at the place that was asked last: of springs alone, on the hand,
        ("slope", np.float64),  # its tension's slope, N/m,
        ("damping", np.float64),  # dampings over a step, N/m,
        ("drift", np.float64),  # and the force of dampers on the motion of their other ends, N;
        ("free_damping", np.float64),  # these two of dampers that act everywhere
        ("free_drift", np.float64),
        ("low", np.float64),  # N, extremes of the law at the places that were asked since they were cleared
        ("high", np.float64),
        ("fastest_way", np.float64),  # m, of the fastest motion in a step
        ("line", np.float64, (5,)),  # F, k, b over a step, low, high
    ],
    align=True,
)
"""The law of a hand around its place, and its line."""

_doubles_at, _whole_at = array_at(np.float64), array_at(np.int64)


@inlined
def _numbers_of(program):
    return _doubles_at(program.query[1], query.QUERY_NUMBERS), _whole_at(program.query[2], query.QUERY_WHOLE)


@inlined
def set_hands_of_law(law, j, measured, before, gap, substeps):
    """Tells program j where the hands are. `measured`, `before`: m by channel, `gap` samples apart."""
    program = program_at(law.programs[j])
    numbers, whole = _numbers_of(program)
    whole[query.TURN] = program.turn
    for h in range(np.uint64(program.hands)):
        c = program.channel[h]
        numbers[np.uint64(query.HANDS) + h] = measured[c]
        numbers[np.uint64(query.WAYS) + h] = (measured[c] - before[c]) / (gap * substeps)


@helper
def find_line(law, channel, x, way, lead, reach):
    """Finds the line of the hand on a channel, in `law.line`. `x`: its place, m; `way`: in the last sample, m; `lead`:
    samples until the line acts; `reach`: m to both sides, until the line ends."""
    count = _collect(law, channel, x - reach, x + reach)
    knots = _doubles_at(program_at(law.programs[0]).query[3], query.MOST_KNOTS)
    begin, end = x + way * lead, x + way * (lead + 1.0)
    law.low, law.high = math.inf, -math.inf
    _bound_between(law, knots, count, x - reach, x + reach)
    if _is_narrow(knots, count, min(begin, end), max(begin, end)):
        at, slope = begin, _chord(law, knots, count, begin, end)
    else:
        at = _tangent_at(law, knots, count, 0.5 * (begin + end), x, reach)
        slope = law.slope
    widest = law.free_damping * law.fastest_way
    law.line[0] = law.force + slope * (at - x) + law.drift
    law.line[1], law.line[2] = slope, law.damping
    law.line[3], law.line[4] = law.low + law.free_drift - widest, law.high + law.free_drift + widest


@helper
def _collect(law, channel, low, high):
    """Collects the knots of the law from `low` to `high` m, and some beyond, in the first program's array. Returns
    their count."""
    first, knots = program_at(law.programs[0]), _doubles_at(program_at(law.programs[0]).query[3], query.MOST_KNOTS)
    _, counts = _numbers_of(first)
    for j in range(2):
        if law.programs[j] != 0:
            program = program_at(law.programs[j])
            numbers, whole = _numbers_of(program)
            whole[query.COUNT], whole[query.COLLECTS], whole[query.HAND] = 0, 1, -1
            numbers[query.FROM], numbers[query.UNTIL], numbers[query.WEIGHT] = low, high, law.weights[j]
            for h in range(program.hands):
                if program.channel[np.uint64(h)] == channel:
                    whole[query.HAND] = h
            call_all(program.line, program.query[0])
            whole[query.COLLECTS] = 0
            more = _doubles_at(program.query[3], query.MOST_KNOTS)
            for i in range(np.uint64(whole[query.COUNT] if j > 0 else 0)):
                add_knot(counts, knots, more[i])
    return counts[query.COUNT]


@helper
def _ask(law, x):
    """Asks for the law at x m, which takes part in the extremes."""
    law.force = law.slope = law.damping = law.drift = law.free_damping = law.free_drift = 0.0
    for j in range(2):
        if law.weights[j] != 0.0:
            program = program_at(law.programs[j])
            numbers, _ = _numbers_of(program)
            numbers[query.X] = x
            for i in range(query.FORCE, query.FREE_DRIFT + 1):
                numbers[np.uint64(i)] = 0.0
            call_all(program.line, program.query[0])
            law.force += numbers[query.FORCE]
            law.slope += numbers[query.SLOPE]
            law.damping += numbers[query.DAMPING]
            law.drift += numbers[query.DRIFT]
            law.free_damping += numbers[query.FREE_DAMPING]
            law.free_drift += numbers[query.FREE_DRIFT]
    law.low, law.high = min(law.low, law.force), max(law.high, law.force)


@helper
def _bound_between(law, knots, count, low, high):
    """Lets the law from `low` to `high` m take part in the extremes."""
    begin = low
    for i in range(np.uint64(count + 1)):
        end = min(knots[i], high) if i < count else high
        if begin < end:
            _ask(law, begin + _INSIDE * (end - begin))
            _ask(law, end - _INSIDE * (end - begin))
            begin = end


@inlined
def _is_narrow(knots, count, low, high):
    """Returns whether a piece that is narrower than the stretch from `low` to `high` m lies in it or overlaps it."""
    narrow = False
    for i in range(np.uint64(max(count - 1, 0))):
        width = knots[i + ONE] - knots[i]
        narrow |= width < high - low and knots[i] < high and knots[i + ONE] > low
    return narrow


@helper
def _chord(law, knots, count, begin, end):
    """Returns the slope of the chord of the law from `begin` to `end` m, N/m; where it is no good, that of the law at
    `begin`, at least 0. The law asked last is that at `begin`."""
    _ask(law, end)
    last = law.force
    _ask(law, begin)
    first, slope = law.force, (law.force - last) / (end - begin)
    low, high, off = min(first, last), max(first, last), 0.0
    for i in range(np.uint64(count)):
        if min(begin, end) < knots[i] < max(begin, end):
            _ask(law, knots[i])
            low, high = min(low, law.force), max(high, law.force)
            off = max(off, abs(law.force - first + slope * (knots[i] - begin)))
    _ask(law, begin)
    return slope if slope > 0.0 and off <= DEVIATION * (high - low) else max(law.slope, 0.0)


@helper
def _tangent_at(law, knots, count, middle, x, reach):
    """Asks for the law at `middle` m, or in the sloping piece beside a flat one there. Returns the place that it asked
    last, m. `x`, `reach`: of the hand, m."""
    right, own = _right_of(knots, count, middle), _right_of(knots, count, x)
    if own != right:
        _ask(law, x)
        slope = law.slope
        _ask(law, middle)
        if slope > max(law.slope, 0.0):
            right, middle = own, x
    _bound_piece(law, knots, count, right, reach, middle)
    below = x - knots[right - ONE] if right > 0 else math.inf
    above = knots[right] - x if right < count else math.inf
    beside = abs(below) if abs(below) <= abs(above) else abs(above)
    is_bound = law.force <= law.low or law.force >= law.high
    if not (abs(law.slope) * reach <= _FLAT * (law.high - law.low) and is_bound and beside <= reach):
        return middle
    low, high = law.low, law.high
    other = right - ONE if abs(below) <= abs(above) else right + ONE
    at = _place_in(knots, count, other, reach)
    _ask(law, at)
    if abs(law.slope) * reach <= _FLAT * (high - low):
        law.low, law.high = low, high
        _ask(law, middle)
        return middle
    _bound_piece(law, knots, count, other, reach, at)
    return at


@inlined
def _right_of(knots, count, x):
    """Returns the first knot to the right of x m."""
    right = np.uint64(0)
    while right < count and knots[right] <= x:
        right += ONE
    return right


@inlined
def _place_in(knots, count, right, reach):
    """Returns a place within the piece to the left of knot `right`, m."""
    if right == 0:
        return knots[0] - reach
    if right >= count:
        return knots[np.uint64(count) - ONE] + reach
    return 0.5 * (knots[right - ONE] + knots[right])


@helper
def _bound_piece(law, knots, count, right, reach, at):
    """Lets the piece to the left of knot `right` take part in the extremes; asks last for the law at `at` m in it."""
    left = knots[right - ONE] if right > 0 else -math.inf
    end = knots[right] if right < count else math.inf
    inside = _INSIDE * min(end - left, reach)
    if left > -math.inf:
        _ask(law, left + inside)
    if end < math.inf:
        _ask(law, end - inside)
    _ask(law, at)
    if (left == -math.inf and law.slope > 0.0) or (end == math.inf and law.slope < 0.0):
        law.high = math.inf
    if (left == -math.inf and law.slope < 0.0) or (end == math.inf and law.slope > 0.0):
        law.low = -math.inf
