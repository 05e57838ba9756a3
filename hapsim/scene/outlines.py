"""The outlines of the surfaces and paths of a scene in the plane, and of the travel, for pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Literal, NamedTuple

from .chain import Chain, Point, disc, polygon
from .modules.surfaces import Guide, Surface, surfaces_of
from .scene import Scene
from .values import Area

FAR = 10.0
"""m, at least from its place to what stands for the end of a half plane."""

_TURNS, _SAME = 8, 1e-9  # places from end to begin of a line from afar to afar; and m: nearer places are one


class Outline(NamedTuple):
    """A line in the plane.

    Attributes:
        name: of the guide, or of the shapes whose surfaces it follows; "" of the travel.
        kind: `outside` and `inside` are surfaces with their material within and without the line.
        of: name of the point that touches it or is led by it; "" of the travel.
        about: name of the point that the places are relative to; "" for position 0.
        places: m, along the line; that of a surface ends where it begins, with its material on the left.
    """

    name: str
    kind: Literal["outside", "inside", "guide", "travel"]
    of: str
    about: str
    places: tuple[Point, ...]


def outlines_of(scene: Scene) -> Iterator[Outline]:
    """Yields the outlines of each surface and guide, in the order of the file, and that of the travel. Of a surface
    with several the first is around all others; together they bound its material."""
    links = scene.plane_links
    surfaces = {next(iter(one.shapes)): one for one in surfaces_of(links)}
    for name, link in links.items():
        if name in surfaces:
            yield from _of_surface(surfaces[name])
        elif isinstance(link, Guide):
            yield Outline(name, "guide", *link.between, tuple(link.chain().outline()))
    if (travel := travel_boundary(scene, scene.channel_groups[0])) is not None:
        (x, y), boundary = travel
        yield Outline("", "travel", "", "", tuple((x + dx, y + dy) for dx, dy in _around(boundary)))


def travel_boundary(scene: Scene, hand: Sequence[int]) -> tuple[Point, Chain] | None:
    """Returns the edge of the travel of the hand on these two channels: the place that it is about, m, and a chain with
    the travel on its left; None without travel."""
    travel = scene.device.travel
    if travel is None or len(hand) < 2:
        return None
    if isinstance(travel, Area):
        return (travel.center, disc(travel.disc)) if travel.disc else ((0.0, 0.0), polygon(travel.polygon))
    (left, right), (low, high) = (scene.device.travels(scene.channels)[one] for one in hand)
    return (0.0, 0.0), polygon([(left, low), (right, low), (right, high), (left, high)])


def travel_in_words(scene: Scene, channel: int) -> str:
    """Words on the travel of the hand of a channel, to follow "goes"."""
    area, units, each = scene.device.travel, scene.units_of(channel), scene.device.travels(scene.channels)
    if isinstance(area, Area):
        center = units(f"({', '.join(units.number(one, 'm', 'g') for one in area.center)})", "m")
        disc = f"up to {units(area.radius, 'm', 'g')} from {center}"
        return f"to the edge of a polygon of {len(area.polygon)} corners" if area.polygon else disc
    ranges = [[units.number(end, "m", "g") for end in each[c]] for c in scene.hand_of(channel)]
    return " and ".join(f"from {least} to {units(most, 'm')}" for least, most in ranges)


def _of_surface(surface: Surface) -> Iterator[Outline]:
    """Yields the outlines of a surface, that around the largest area first."""
    names, (chain, owners), found = [*surface.shapes], surface.outline, list[tuple[float, Outline]]()
    for way in _ways(chain):
        own = ", ".join(dict.fromkeys(names[owners[k]] for k in way))
        places = _around(Chain(tuple(chain.pieces[k] for k in way)))
        area = sum(x * v - y * u for (x, y), (u, v) in pairwise(places))
        found.append((abs(area), Outline(own, "outside" if area > 0.0 else "inside", *surface.between, places)))
    yield from (one for _, one in sorted(found, key=lambda one: -one[0]))


def _ways(chain: Chain) -> Iterator[list[int]]:
    """Yields the numbers of the pieces of each loop, and of each line from afar to afar, in the order of the way."""
    left = dict.fromkeys(sorted(range(len(chain.pieces)), key=lambda k: chain.pieces[k].before != k))
    while left:
        way = [next(iter(left))]
        del left[way[0]]
        while (after := chain.pieces[way[-1]].after) in left:
            way.append(after)
            del left[after]
        yield way


def _around(boundary: Chain) -> tuple[Point, ...]:
    """Returns the outline of a surface; one from afar to afar is closed far within its material."""
    points, (first, *_) = boundary.outline(), boundary.pieces
    if math.isinf(first.extent):
        deep = -2.0 * FAR * first.ey, 2.0 * FAR * first.ex
        points += [(x + deep[0], y + deep[1]) for x, y in reversed(points)]
    elif math.dist(points[0], points[-1]) > FAR:
        last = boundary.pieces[-1]
        begin, end = math.atan2(-first.ey, -first.ex), math.atan2(last.ey, last.ex)
        turns = [end + i / _TURNS * ((begin - end) % (2.0 * math.pi)) for i in range(_TURNS + 1)]
        near = [one for one in points[1:-1] if math.dist(one, first.at(1.0)) > _SAME]  # there it only comes nearer
        points = [*near, *((2.0 * FAR * math.cos(turn), 2.0 * FAR * math.sin(turn)) for turn in turns)]
    return (*points, points[0])
