"""Force over the position of a hand whose links all end on grounds: what `chart force` and the page draw."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from hapsim.prediction.characteristic import Characteristic
from hapsim.prediction.correction import felt_error
from hapsim.prediction.stability import Region
from hapsim.theory.arrays import Floats

_MARGIN = 0.3  # of what has edges, drawn beyond them
_LITTLE = 0.01  # of the largest energy of a snap: no label
_STEEP = 2.0  # times the largest force at an edge: a stop is drawn no further
_NO_FORCE = 1e-9  # of the largest


def has_curve(hand: Characteristic) -> bool:
    """Returns whether the force depends on the place by more than one straight line."""
    return any(one.law.edges and not one.law.is_dry for one in hand.links.values())


def view_of(hand: Characteristic, regions: Sequence[Region]) -> tuple[float, float]:
    """Returns the ends of a picture's position axis, m: around the edges, within the travel and the force limit."""
    places = [one.piece.place for one in regions]
    edges = hand.edges()
    low, high = min([*edges, *places]), max([*edges, *places])
    room = _MARGIN * (high - low) or 2.0 * hand.free  # where nothing else says how much
    low, high = max(low - room, hand.low), min(high + room, hand.high)
    x = np.linspace(low, high, 2001)
    inner = _STEEP * max(map(abs, hand.force(np.array(edges))), default=0.0)
    most = min(hand.force_limit, max(inner, *np.abs(hand.force(np.array(places)))))
    within = x[np.abs(hand.force(x)) <= most]
    return (float(within[0]), float(within[-1])) if within.size > 1 else (low, high)


def places_within(low: float, high: float, count: int) -> Floats:
    """Returns `count` places from one to the other, m, just within: a force that jumps there is the inner one."""
    return np.linspace(low, high, count) + (high - low) * 1e-9 * np.linspace(1.0, -1.0, count)


def error_of(region: Region) -> float:
    """Returns the `felt_error` of k and b against those that the scene asks for there; NaN where nothing holds."""
    if region.kind != "held":
        return math.nan
    felt, device = region.felt, region.felt.configuration
    wanted = region.piece.stiffness + device.stiffness, region.piece.damping + device.friction
    return float(felt_error((np.array(felt.k), np.array(felt.b)), wanted, device.mass))


def snaps_of(regions: Iterable[Region]) -> list[tuple[float, float]]:
    """Returns the middle, m, of each flank of these regions that drives the hand on, and the energy that a hand gains
    on it, J, without those of little energy beside others."""
    found: dict[float, float] = {}
    for one in regions:
        if one.kind == "snap":
            flank = one.hand.flank_at(0.5 * (one.piece.low + one.piece.high))
            found.setdefault(one.piece.place if flank is None else 0.5 * (flank.low + flank.high), one.snap_energy)
    most = max(found.values(), default=0.0)
    return [one for one in found.items() if not 0.0 < one[1] < _LITTLE * most]


def rests_of(x: Floats, force: Floats) -> list[tuple[float, float]]:
    """Returns the places to which a force (N, of the hand) over ascending positions (m) brings a hand back from both
    sides; with an extent where it is zero between."""
    scale = _NO_FORCE * float(np.max(np.abs(force), initial=0.0))
    signs = np.where(np.abs(force) > scale, np.sign(force), 0.0)
    found = []
    for i, j in pairwise(np.flatnonzero(signs).tolist()):
        if signs[i] < 0.0 < signs[j]:
            crossing = float(np.interp(0.0, force[[i, j]], x[[i, j]]))
            found.append((crossing, crossing) if j == i + 1 else (float(x[i + 1]), float(x[j - 1])))
    return found


def stops_of(hand: Characteristic) -> list[tuple[float, int]]:
    """Returns the places of the stops, m, and the way in which each pushes the hand back: 1 up, -1 down."""
    found = []
    for one in hand.links.values():
        way = 1 if one.sign > 0.0 else -1
        is_one = len(one.law.states) > 1 and not one.law.period and not one.law.is_dry and not one.law.variants
        if is_one and one.law.below > 0.0:
            found.append((one.fixed_m + way * one.law.knots[0][0], way))
        if is_one and one.law.beyond > 0.0:
            found.append((one.fixed_m + way * one.law.knots[-1][0], -way))
    return found
