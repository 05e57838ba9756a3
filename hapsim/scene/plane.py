"""A scene of the plane to look at: where its points start, the outlines of its surfaces and paths, and the travel."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

from .chain import Chain, Point
from .modules.plane_links import Guide, Shape
from .scene import AXES, Scene

FAR = 10.0
"""m, at least from its place to what stands for the end of a half plane."""


class Outline(NamedTuple):
    """A line in the plane.

    Attributes:
        name: of the shape or guide; "" of the travel.
        kind: `outside` and `inside` are shapes with their material within and without the line.
        about: name of the point that the places are relative to; "" for position 0.
        places: m, along the line; that of a shape ends where it begins.
    """

    name: str
    kind: Literal["outside", "inside", "guide", "travel"]
    about: str
    places: tuple[Point, ...]


def places_of(scene: Scene) -> dict[str, Point]:
    """Returns where each point starts, m: the hands where the mock does."""
    origins = zip(scene.mock_device.initial_position, scene.device.origins(scene.channels), strict=True)
    hands = [0.0 if origin is None else x - origin for x, origin in origins]
    at = {name: one.position for name, one in (scene.grounds | scene.masses).items()}
    at |= {name: hands[one.channel] for name, one in scene.device_points.items()}
    points = [name for name in scene.modules if f"{name}.{AXES[0]}" in at]
    return {name: (at[f"{name}.{AXES[0]}"], at[f"{name}.{AXES[1]}"]) for name in points}


def outlines_of(scene: Scene) -> Iterator[Outline]:
    """Yields the outline of each shape and guide, in the order of the file, and that of the travel."""
    for name, link in scene.plane_links.items():
        if isinstance(link, Shape):
            yield Outline(name, link.side, link.between[1], _around(link.chain()))
        elif isinstance(link, Guide):
            yield Outline(name, "guide", link.between[1], tuple(link.chain().outline()))
    for x, y in scene.channel_groups if scene.space > 1 else ():
        (left, right), (low, high) = (scene.device.travels(scene.channels)[channel] for channel in (x, y))
        if all(map(math.isfinite, (left, right, low, high))):
            yield Outline("", "travel", "", ((left, low), (right, low), (right, high), (left, high), (left, low)))


def _around(boundary: Chain) -> tuple[Point, ...]:
    """Returns the outline of a shape; that of a half plane is closed far within its material."""
    points, (first, *_) = boundary.outline(), boundary.pieces
    if math.isinf(first.extent):
        deep = -2.0 * FAR * first.ey, 2.0 * FAR * first.ex
        points += [(x + deep[0], y + deep[1]) for x, y in reversed(points)]
    return (*points, points[0])
