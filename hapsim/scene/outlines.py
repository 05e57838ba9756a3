"""The outlines of the surfaces and paths of a scene in the plane, and of the travel, for pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Literal, NamedTuple

from .chain import Chain, Point, disc, polygon
from .modules.surfaces import Guide, Shape
from .quantity import Area
from .scene import Scene

FAR = 10.0
"""m, at least from its place to what stands for the end of a half plane."""


class Outline(NamedTuple):
    """A line in the plane.

    Attributes:
        name: of the shape or guide; "" of the travel.
        kind: `outside` and `inside` are shapes with their material within and without the line.
        of: name of the point that touches it or is led by it; "" of the travel.
        about: name of the point that the places are relative to; "" for position 0.
        places: m, along the line; that of a shape ends where it begins.
    """

    name: str
    kind: Literal["outside", "inside", "guide", "travel"]
    of: str
    about: str
    places: tuple[Point, ...]


def outlines_of(scene: Scene) -> Iterator[Outline]:
    """Yields the outline of each shape and guide, in the order of the file, and that of the travel."""
    for name, link in scene.plane_links.items():
        if isinstance(link, Shape):
            yield Outline(name, link.side, *link.between, _around(link.chain()))
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


def _around(boundary: Chain) -> tuple[Point, ...]:
    """Returns the outline of a shape; that of a half plane is closed far within its material."""
    points, (first, *_) = boundary.outline(), boundary.pieces
    if math.isinf(first.extent):
        deep = -2.0 * FAR * first.ey, 2.0 * FAR * first.ex
        points += [(x + deep[0], y + deep[1]) for x, y in reversed(points)]
    return (*points, points[0])
