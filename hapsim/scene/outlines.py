"""The outlines of the surfaces and paths of a scene in the plane, and of the travel, for pictures."""

from __future__ import annotations

import math
from collections.abc import Iterator
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
    travel = scene.device.travel
    if isinstance(travel, Area):
        x, y = travel.center if travel.disc else (0.0, 0.0)
        around = _around(disc(travel.disc) if travel.disc else polygon(travel.polygon))
        yield Outline("", "travel", "", "", tuple((x + dx, y + dy) for dx, dy in around))
    elif travel is not None and scene.space > 1:
        (left, right), (low, high) = (scene.device.travels(scene.channels)[one] for one in scene.channel_groups[0])
        yield Outline("", "travel", "", "", _around(polygon([(left, low), (right, low), (right, high), (left, high)])))


def _around(boundary: Chain) -> tuple[Point, ...]:
    """Returns the outline of a shape; that of a half plane is closed far within its material."""
    points, (first, *_) = boundary.outline(), boundary.pieces
    if math.isinf(first.extent):
        deep = -2.0 * FAR * first.ey, 2.0 * FAR * first.ex
        points += [(x + deep[0], y + deep[1]) for x, y in reversed(points)]
    return (*points, points[0])
