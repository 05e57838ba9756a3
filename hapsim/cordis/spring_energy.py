"""Energy of one spring of a scene in the state of a sample, and the record that lists all springs and masses."""

from __future__ import annotations

import math

import numpy as np

from hapsim.compiling import helper, inlined
from hapsim.compiling.native import array_at, record_at

SPRING, BRISTLE, SINE, TABLE, SLIDER, HELD = range(6)

ON_A_LINE, BETWEEN, FROM_PLACE, ALONG = range(4)

SPRING_RECORD = np.dtype(
    [
        ("kind", np.int64),
        ("measured", np.int64),  # how: the distance of its ends, in the plane that of two points,
        ("place", np.uint64, (2,)),  # with the remembered direction here; from a place here; along a normal here
        ("ends", np.int64, (2,)),  # numbers of points,
        ("at", np.uint64, (2,)),  # or, where not 0, addresses of where they stand
        ("stiffness", np.uint64),  # address of K, N/m
        ("share", np.float64),  # of that
        ("ratio", np.float64),  # weight of the second end in the distance
        ("weight", np.float64),  # of its energy (scene/scaled_links.py)
        ("offset", np.uint64),  # address of the distance at which it is not stretched; 0: none
        ("most", np.float64),  # N, beyond which no hand feels it
        ("side", np.uint64),  # address of the memory of a bristle, a plectrum, a held detent, or of a slider's anchor
        ("force", np.uint64),  # address of a bristle's force while it slides, or, where there is a pressure, of
        ("press", np.uint64),  # the coefficient; address of the pressure, N
        ("free", np.float64),  # m, about the rest, within which it is not stretched,
        ("reach", np.float64),  # and beyond which it has no force, or slides
        ("shape", np.uint64, (5,)),  # addresses of a sine's pitch, depth; of a table's edges to period; of a held
        # detent's rests, pitch, depth, dead zone and hold; that of its stop is `stiffness`, of what holds `force`
        ("knots", np.int64),  # of a table, how many; of a detent its places
        ("low", np.uint64),  # addresses of the ends of a contact's stretch without force; 0: it has no such end
        ("high", np.uint64),
    ],
    align=True,
)

STORED = np.dtype(
    [
        ("address", np.uint64),  # of all this,
        ("evaluate", np.uint64),  # and of `evaluate`
        ("single", np.int64),  # 1: numbers of single precision
        ("springs", np.uint64),  # address of them,
        ("count", np.int64),  # and how many
        ("live", np.uint64, (2,)),  # where the live values begin and end
        ("points", np.uint64),  # addresses of the numbers of points with a mass,
        ("masses", np.uint64),  # and of m/(2 T²), N/m
        ("mass_count", np.int64),
        ("tank", np.uint64),  # address of a TANK
    ],
    align=True,
)

stored_at, springs_at = record_at(STORED), array_at(SPRING_RECORD)
_doubles_at, _singles_at = array_at(np.float64), array_at(np.float32)


@inlined
def number_at(address, i, single):
    """Returns number i at an address."""
    if single:
        return np.float64(_singles_at(address, i + 1)[np.uint64(i)])
    return _doubles_at(address, i + 1)[np.uint64(i)]


@inlined
def put_number(address, i, single, number):
    """Writes number i at an address."""
    if single:
        _singles_at(address, i + 1)[np.uint64(i)] = number
    else:
        _doubles_at(address, i + 1)[np.uint64(i)] = number


@helper
def depth_in_contacts(stored, position, point):
    """Returns how deep a point is in the contact that it is deepest in, m; 0 if it is in none."""
    springs, depth, none = springs_at(stored.springs, stored.count), 0.0, np.uint64(0)
    for i in range(stored.count):
        spring = springs[i]
        is_end = (spring.ends[0] == point and spring.at[0] == 0) or (spring.ends[1] == point and spring.at[1] == 0)
        if is_end and (spring.low != 0 or spring.high != 0):
            d = stretch_of(stored, spring, position, none)
            below = _value(stored, spring.low, none) - d if spring.low != 0 else 0.0
            above = d - _value(stored, spring.high, none) if spring.high != 0 else 0.0
            depth = max(depth, below, above)
    return depth


@helper
def stretch_of(stored, spring, position, way):
    """Returns the distance of a spring's ends beyond its offset, m."""
    d = _end(stored, spring, position, way, 0, 0) - spring.ratio * _end(stored, spring, position, way, 1, 0)
    if spring.measured != ON_A_LINE:
        y = _end(stored, spring, position, way, 0, 1) - _end(stored, spring, position, way, 1, 1)
        d = _distance(spring, d, y, stored.single)
    return d - _value(stored, spring.offset, way) if spring.offset else d


@helper
def spring_energy(stored, spring, position, way):
    """Returns the energy of a spring, J, times its weight."""
    return spring.weight * _energy_of(stored, spring, position, way)


@helper
def _energy_of(stored, spring, position, way):
    d = stretch_of(stored, spring, position, way)
    if spring.kind == TABLE:
        return _table_energy(spring, d, way, stored.single)
    if spring.kind == SINE:
        pitch, depth = _value(stored, spring.shape[0], way), _value(stored, spring.shape[1], way)
        return depth * pitch / math.pi * math.sin(math.pi * d / pitch) ** 2
    if spring.kind == SLIDER:
        return _slider_energy(spring, d, way, stored.single)
    if spring.kind == HELD:
        return _held_energy(stored, spring, d, way)
    stiffness = spring.share * _value(stored, spring.stiffness, way)
    side = number_at(spring.side, 0, stored.single) if spring.side else 0.0
    if spring.kind == SPRING and side * d > 0.0:
        return 0.0
    if spring.kind == BRISTLE and side != 0.0 and stiffness > 0.0:
        press = number_at(spring.press, 0, stored.single) if spring.press else 1.0
        d = press * _value(stored, spring.force, way) / stiffness
    if abs(d) > spring.reach:
        return 0.0
    return _spring_work(stiffness, max(abs(d) - spring.free, 0.0), spring.most)


@helper
def tension_of(spring, d, single):
    """Returns a table's tension (N) at `d` m, without a damper: exactly 0 between two knots without one."""
    edges, tensions, period = spring.shape[0], spring.shape[1], number_at(spring.shape[4], 0, single)
    at, tension = number_at(edges, 0, single), number_at(tensions, 0, single)
    first, at_first = at, tension
    if period > 0.0:
        d -= period * math.floor((d - first) / period)
    if d < at:
        return tension + number_at(spring.shape[2], 0, single) * (d - at)
    for i in range(1, spring.knots + (period > 0.0)):
        is_knot = i < spring.knots
        end = number_at(edges, i, single) if is_knot else first + period
        rise = (number_at(tensions, i, single) if is_knot else at_first) - tension
        if d < end:
            return tension + rise * (d - at) / (end - at)
        at, tension = end, tension + rise
    return tension + number_at(spring.shape[3], 0, single) * (d - at)


@inlined
def _end(stored, spring, position, way, end, axis):
    if spring.at[end]:
        return _value(stored, spring.at[end] + np.uint64(axis * (4 if stored.single else 8)), way)
    return number_at(position, spring.ends[end] + axis, stored.single)


@helper
def _distance(spring, x, y, single):
    """Returns the distance of two ends (x, y) apart in the plane, m; negative beyond the point where they meet, as long
    as the remembered direction is that of before."""
    at_x, at_y = number_at(spring.place[0], 0, single), number_at(spring.place[1], 0, single)
    along = at_x * x + at_y * y
    if spring.measured == ALONG or (spring.measured == BETWEEN and along < 0.0):
        return along
    if spring.measured == FROM_PLACE:
        x, y = x - at_x, y - at_y
    return math.sqrt(x * x + y * y)


@helper
def _value(stored, address, way):
    """Returns a live value, `way` bytes further on, or a constant."""
    if address >= stored.live[0] and address < stored.live[1]:
        address += way
    return number_at(address, 0, stored.single)


@helper
def _table_energy(spring, d, way, single):
    """Returns a table's energy above its minimum along the knots, J; beyond them with a force of at most `most` N."""
    edges, tensions = spring.shape[0] + way, spring.shape[1] + way
    below, beyond = number_at(spring.shape[2] + way, 0, single), number_at(spring.shape[3] + way, 0, single)
    period = number_at(spring.shape[4] + way, 0, single)
    first, at_first = number_at(edges, 0, single), number_at(tensions, 0, single)
    if period > 0.0:
        d -= period * math.floor((d - first) / period)
    done, whole = _work_beyond(max(first - d, 0.0), -at_first, below, spring.most), 0.0
    least = _least_beyond(-at_first, below)
    at, tension = first, at_first
    for i in range(1, spring.knots + (period > 0.0)):
        if i < spring.knots:
            width, rise = number_at(edges, i, single) - at, number_at(tensions, i, single) - tension
        else:
            width, rise = first + period - at, at_first - tension
        if width > 0.0:
            part = min(max(d - at, 0.0), width)
            done += part * (tension + 0.5 * part * rise / width)
            if tension < 0.0 < tension + rise:
                least = min(least, whole - 0.5 * tension * tension * width / rise)
        whole += width * (tension + 0.5 * rise)
        at, tension = at + width, tension + rise
        least = min(least, whole)
    if period > 0.0:
        return done - least
    done += _work_beyond(max(d - at, 0.0), tension, beyond, spring.most)
    return done - min(least, whole + _least_beyond(tension, beyond))


@helper
def _slider_energy(spring, d, way, single):
    """Returns what is stored between two branches, J: h over the way to where z is 0, weighted with what is left of
    that way, over `reach`."""
    edges, halves = spring.shape[0] + way, spring.shape[1] + way
    begin = min(max(number_at(spring.side, 0, single), d - spring.reach), d + spring.reach)
    low, high, total = min(begin, d), max(begin, d), 0.0
    for i in range(-1, spring.knots):
        one, next_one = max(i, 0), min(i + 1, spring.knots - 1)
        at, end = number_at(edges, one, single), number_at(edges, next_one, single)
        x, until = max(low, at) if i >= 0 else low, min(high, end) if next_one > i else high
        if until > x:
            h = number_at(halves, one, single)
            slope = (number_at(halves, next_one, single) - h) / (end - at) if end > at else 0.0
            middle = 0.5 * (x + until)
            weighted = (h + slope * (x - at)) * abs(x - begin) + (h + slope * (until - at)) * abs(until - begin)
            weighted += 4.0 * (h + slope * (middle - at)) * abs(middle - begin)
            total += (until - x) / 6.0 * weighted  # by Simpson's rule, exact for a square
    return total / spring.reach


@helper
def _held_energy(stored, spring, d, way):
    """Returns the energy of a detent in the place that holds it, J; beyond the limit as of a spring."""
    place, single = number_at(spring.side, 0, stored.single), stored.single
    pitch, depth = _value(stored, spring.shape[1], way), _value(stored, spring.shape[2], way)
    free, hold = _value(stored, spring.shape[3], way), _value(stored, spring.shape[4], way)
    k = 0 if pitch > 0.0 else min(max(np.int64(place), 0), spring.knots - 1)
    rest = number_at(spring.shape[0], k, single)
    u = d - rest - pitch * place
    beside = k + 1 if u > 0.0 else k - 1
    is_stop = not pitch > 0.0 and not 0 <= beside < spring.knots
    stiffness = _value(stored, spring.stiffness, way) if is_stop else -1.0
    if stiffness < 0.0:  # of the flank here, or, at the end, of the one on the other side
        other = min(max(2 * k - beside if is_stop else beside, 0), spring.knots - 1)
        reach = hold * (pitch if pitch > 0.0 else abs(number_at(spring.shape[0], other, single) - rest)) - free
        stiffness = depth / reach if reach > 0.0 else 0.0
    if not is_stop and number_at(spring.force, k, single) == 0.0:
        return 0.0
    return _spring_work(stiffness, max(abs(u) - free, 0.0), spring.most)


@inlined
def _spring_work(stiffness, d, most):
    """Returns the energy of a spring, J, that is stretched by `d` m and gives at most `most` N."""
    if stiffness * d > most:
        return most * (d - 0.5 * most / stiffness)
    return 0.5 * stiffness * d * d


@inlined
def _work_beyond(way, force, slope, most):
    """Returns the work against a force that begins at `force` and rises with `slope` up to `most` N, J."""
    bent = min(way, max(most - force, 0.0) / slope) if slope > 0.0 else way
    return (
        bent * (force + 0.5 * slope * bent) + (way - bent) * most if bent < way else way * (force + 0.5 * slope * way)
    )


@inlined
def _least_beyond(force, slope):
    """Returns the minimum of that work over all ways without a limit, J."""
    return -0.5 * force * force / slope if force < 0.0 < slope else 0.0
