"""Views of a scene on the page, and the force over the position of a hand on grounds."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from hapsim.prediction import Part, Prediction, Region
from hapsim.prediction.characteristic import Characteristic, characteristic_of, scene_at
from hapsim.prediction.force_curve import error_of, has_curve, places_within, rests_of, snaps_of, stops_of, view_of
from hapsim.prediction.linear import coupling_reason
from hapsim.scene import Detent, Scene
from hapsim.theory.arrays import Floats

View = Literal["force", "dial", "plane", "picture"]

_POINTS = 25  # of a curved region
_SIDE = 4  # regions to either side of the hand that a picture of many shows; twice as many are sent
_SLOWLY = 1e-12  # m/s: a direction without a speed
_ALIKE = 1e-6  # of the force limit, or of a period


def views_of(scene: Scene, has_mock: bool) -> list[View]:
    """Returns the views of a scene: force over place of a hand whose force is more than a straight line, a dial if it
    turns; the plane of K and B of hands on grounds; the picture, also where nothing else drags the mock."""
    points = scene.device_points
    hands = {name: hand for name in points if (hand := characteristic_of(scene, name)) is not None}
    linear = scene_at(scene) if hands else None
    alone = {name: one for name, one in hands.items() if linear and not coupling_reason(scene, linear, name)}
    curved = [points[name].channel for name, one in alone.items() if has_curve(one)]
    is_more = bool(scene.material_points or scene.structures) or len(points) > 1
    turns = any(scene.units_of(channel).is_rotary for channel in curved)
    shown: dict[View, bool] = {"force": bool(curved), "dial": turns, "plane": bool(alone)}
    shown["picture"] = is_more or (has_mock and not curved)
    return [view for view, is_shown in shown.items() if is_shown]


class Near(NamedTuple):
    """The regions about the place of a hand, with friction stuck and curves between their branches.

    Attributes:
        regions: by position.
        at: the place among them, m, within the travel.
        period: m, in which the force repeats without end; 0 if it does not.
        shift: whole periods, m, by which the hand is elsewhere.
    """

    regions: Sequence[Region]
    at: float
    period: float
    shift: float

    @property
    def number(self) -> int:
        """Number of the hand's region; on an edge of the stiffer one, beyond the travel of the last."""
        pieces = [one.piece for one in self.regions]
        here = [i for i, one in enumerate(pieces) if one.low <= self.at <= one.high]
        return max(here, key=lambda i: pieces[i].stiffness)


def near(prediction: Prediction, part: Part, at: Mapping[str, float]) -> Near | None:
    """Returns the regions of a hand about its place, m [default: the assumed one]. None if it feels the same
    everywhere."""
    name, assumed = part.names[0], part.region_here
    if assumed is None:
        return None
    x, every = at.get(name, assumed.piece.place), prediction.regions[name]
    hand, travels = every[0].hand, prediction.scene.device.travels(prediction.scene.channels)
    is_endless = (hand.low, hand.high) != travels[part.channels[0]]  # of a force that repeats only so much is there
    period = hand.period if is_endless else 0.0
    shift = period * math.floor((x - hand.low) / period) if period else 0.0
    if is_endless and not period:  # in steps, so that a picture does not move with the hand
        step = max(link.law.period for link in hand.links.values())
        around = step * round(x / step)
        every = prediction.regions_of(name, around) if around else every
        if not every[0].piece.low <= x <= every[-1].piece.high:
            every = prediction.regions_of(name, x)
    regions = tuple(one for one in every if one.piece.is_first)
    return Near(regions, min(max(x - shift, regions[0].piece.low), regions[-1].piece.high), period, shift)


def curve_of(scene: Scene, name: str, about: Near | None) -> dict[str, Any] | None:
    """Returns the field `curve` of `predicted`: the force over the position of a hand, N and m; of one that repeats
    without end, a period of it. None if it is a straight line."""
    if about is None or not has_curve(hand := about.regions[0].hand):
        return None
    regions, period, shift = about.regions, about.period, about.shift
    first = regions[0].piece.low
    once = [one for one in regions if not period or one.piece.low < first + (1.0 - _ALIKE) * period]
    is_long = bool(period) or len(once) > 4 * _SIDE
    if period:
        room = period * max(1.0, _SIDE / len(once))
        view, ends = (about.at - room, about.at + room), (first, first + period)
    else:
        few = [one.piece for one in regions[max(about.number - _SIDE, 0) : about.number + _SIDE + 1]]
        edges = [end for one in few for end in (one.low, one.high) if math.isfinite(end)]
        half = 0.5 * (2 * _SIDE + 1) / len(few) * (max(edges) - min(edges))  # at an end of the travel there are fewer
        view = (about.at - half, about.at + half) if is_long else view_of(hand, regions)
        room = view[1] - view[0]
        ends = max(view[0] - room, hand.low), min(view[1] + room, hand.high)
    x = np.concatenate([_positions(one, one.piece.high - 1.0, one.piece.low + 1.0) for one in once])
    x = np.concatenate([x, x + period]) if period else x  # a place may be where a period begins
    places = rests_of(x, hand.force(x))
    if period:
        places = [one for one in places if one[0] < places[0][0] + (1.0 - _ALIKE) * period]
    sent = [one for one in once if one.piece.low < ends[1] and one.piece.high > ends[0]]
    return {
        "hand": name,
        "at": about.at + shift,
        "view": [end + shift for end in view],
        "follows": is_long,
        "period": period or None,
        "own_stiffness": hand.own_stiffness,
        "regions": [_region(one, *ends) for one in sent],
        "snaps": snaps_of(sent),
        "places": [_short(one) for one in places if abs(one[0] - about.at) < max(room, math.tau)],
        "stops": stops_of(hand),
        "held": _held(scene, hand),
    }


def _positions(region: Region, low: float, high: float) -> Floats:
    """Returns positions of a region between these, m, among which its force is straight enough to be drawn."""
    piece = region.piece
    low, high = (piece.low if math.isfinite(piece.low) else low), (piece.high if math.isfinite(piece.high) else high)
    x = places_within(low, high, _POINTS if piece.is_curved else 2)
    jumps = [
        edge
        for link in region.hand.links.values()
        for way in getattr(link.law, "ways", ())
        for edge in link._replace(law=way).edges(low, high)
    ]
    beside = (high - low) * 1e-9
    return np.sort([*x, *(edge + side for edge in jumps for side in (-beside, beside))])


def _region(region: Region, low: float, high: float) -> dict[str, Any]:
    """Returns a region between these positions, m, with its force (N) at rest, and where they differ those on the way
    up and down."""
    hand, piece = region.hand, region.piece
    low, high = max(low, piece.low), min(high, piece.high)
    x = _positions(region, low, high)
    x = x[(x >= low) & (x <= high)]
    force, up, down = hand.force(x), hand.moving_force(x, _SLOWLY), hand.moving_force(x, -_SLOWLY)
    has_ways = float(np.max(np.abs(up - down))) > _ALIKE * hand.force_limit
    columns = {"x": x, "f": force} | ({"up": up, "down": down} if has_ways else {})
    about = {"low": low, "high": high, "kind": region.kind, "stable": region.is_stable, "error": error_of(region)}
    return about | {key: _short(values) for key, values in columns.items()}


def _short(values: Iterable[float]) -> list[float]:
    return [float(f"{one:.7g}") for one in values]


def _held(scene: Scene, hand: Characteristic) -> dict[str, Any]:
    """Returns the places of each detent that holds: m by number, or m of number 0 with the pitch, m, to the next."""
    found = {}
    for name, link in hand.links.items():
        detent = scene.modules[name]
        if isinstance(detent, Detent) and detent.is_held:
            at = (link.fixed_m + link.sign * one for one in detent.rests)
            found[name] = {"at": _short(at), "pitch": link.sign * detent.period}
    return found
