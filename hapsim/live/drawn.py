"""The list of what the page draws of a scene of any kind, and rows of numbers in its order: where everything is, and
which contacts touch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from hapsim.errors import UsageError
from hapsim.running.session_view import SessionView
from hapsim.scene import DevicePoint, Ground, Scene
from hapsim.scene.modules import MaterialPoint, Structure
from hapsim.scene.outlines import outlines_of

MOST_IN_STRING, MOST_IN_ROW = 2000, 64
"""Masses that are shown of a string, and of each row and column of a membrane, beside those that links hold: some two
pixels of a wide screen each."""


class Entry(BaseModel):
    """One thing to draw."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str


class PointEntry(Entry):
    """A point. A row has its position in m or rad; in the plane x and y."""

    kind: Literal["hand", "mass", "ground"]
    channels: tuple[int, ...] = ()
    """Channels of a hand."""
    rest: float | None = None
    """Position, m, at which a spring of its own holds it."""


class StructureEntry(Entry):
    """A string, or a membrane. A row has the positions of its masses, m, row by row."""

    kind: Literal["structure"] = "structure"
    rows: list[int] | None
    """Numbers of the rows of a membrane that are shown; None for a string."""
    columns: list[int]
    """Numbers of the masses of each row that are shown."""
    rest: float
    is_fixed: tuple[bool, ...]
    """True for each end, or edge (top, bottom, left, right), that is fixed."""

    def masses(self) -> list[str]:
        """Returns the names of the masses that are shown."""
        rows = [f"{self.name}.{row}" for row in self.rows] if self.rows else [self.name]
        return [f"{row}.{column}" for row in rows for column in self.columns]


class LinkEntry(Entry):
    """A link. A row has 1 while a contact touches, 0 while it does not, and nothing of other links."""

    kind: Literal["link"] = "link"
    type: str
    between: tuple[str, str]
    is_contact: bool
    has_outline: bool
    """True of shapes and guides, which are drawn as outlines."""


class OutlineEntry(Entry):
    """A line of a scene with space: 2: the edge of shapes, a guide, or the travel. A row has nothing of it.

    Shapes with the same two ends are one surface. Its lines follow each other, that around all others first, and bound
    its material together. The name is that of the guide, or of the shapes along it, with commas.
    """

    kind: Literal["outside", "inside", "guide", "travel"]
    """`outside` and `inside` are lines of a surface: its material is within, or without."""
    of: str
    """Name of the point that touches it or is led along it: its coordinates are "hand.x" and "hand.y"."""
    about: str
    """Name of the point that carries it; empty: position 0."""
    places: tuple[tuple[float, float], ...]
    """x and y relative to that point, m."""


AnyEntry = PointEntry | StructureEntry | LinkEntry | OutlineEntry


def drawn_of(scene: Scene) -> list[AnyEntry]:
    """Returns all that is drawn of a scene: points and structures in the order of the file, links, outlines."""
    outlines = [OutlineEntry(**one._asdict()) for one in outlines_of(scene)] if scene.space > 1 else []
    return [*_placed(scene), *_links(scene), *outlines]


def _placed(scene: Scene) -> Iterator[PointEntry | StructureEntry]:
    held: dict[str, set[tuple[int, ...]]] = {}
    for link in scene.links.values():
        for name, _, place in (end.partition(".") for end in link.between):
            held.setdefault(name, set()).add(tuple(map(int, filter(None, place.split(".")))))
    for name, module in scene.modules.items():
        if isinstance(module, DevicePoint):
            yield PointEntry(name=name, kind="hand", channels=module.all_channels)
        elif isinstance(module, Ground):
            yield PointEntry(name=name, kind="ground")
        elif isinstance(module, MaterialPoint):
            spring = module.held_by()
            yield PointEntry(name=name, kind="mass", rest=None if spring is None else spring.rest)
        elif isinstance(module, Structure):
            yield _structure(name, module, held.get(name, set()))


def _structure(name: str, module: Any, held: set[tuple[int, ...]]) -> StructureEntry:
    """Returns a structure with every n-th of its masses. `held`: places of those that links hold, which are shown."""
    counts = [getattr(module, field) for field in module.counts]
    most = MOST_IN_STRING if len(counts) == 1 else MOST_IN_ROW
    *rows, columns = (
        sorted({*range(0, count, -(-count // most)), count - 1} | {place[axis] for place in held if place})
        for axis, count in enumerate(counts)
    )
    sides = module.edges if rows else module.ends
    fixed = tuple(side != "free" for side in sides)
    return StructureEntry(
        name=name, rows=rows[0] if rows else None, columns=columns, rest=module.position, is_fixed=fixed
    )


def _links(scene: Scene) -> Iterator[LinkEntry]:
    for name, link in (scene.links | scene.plane_links).items():
        is_contact = link.remembers_touch is not None or bool((law := link.table()) and law.without_force)
        yield LinkEntry(
            name=name, type=link.type, between=link.between, is_contact=is_contact, has_outline=link.chain() is not None
        )


class Picture:
    """The rows of what is drawn of a session."""

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._names: list[str] = []
        self._contacts: list[_Touches] = []
        self._remembered: set[str] = set()

    def row(self, session: SessionView) -> tuple[int, NDArray[np.float64]] | None:
        """Returns the newest sample's number, and the numbers of each entry of `drawn_of`, in its order; None while
        the loop has other modules than the scene, as it may for a moment when it adopts one."""
        if session.scene is not self._scene:
            scene = self._scene = session.scene
            self._names = []
            for one in _placed(scene):
                self._names += one.masses() if isinstance(one, StructureEntry) else scene.coordinates_of(one.name)
            numbers = {name: i for i, name in enumerate(self._names)}
            self._contacts = [_touches(scene, one.name, numbers) for one in _links(scene) if one.is_contact]
            links = {**scene.links, **scene.plane_links}.values()
            self._remembered = {one.remembers_touch[0] for one in links if one.remembers_touch is not None}
        try:
            sample, places = session.positions(self._names)
            remembered = {column: session.remembered(column) for column in self._remembered}
            return sample, np.append(places, [touches(places, remembered) for touches in self._contacts])
        except (UsageError, KeyError):
            return None


_Touches = Callable[[NDArray[np.float64], Mapping[str, Mapping[str, float]]], bool]
"""Function that returns whether a contact touches: of the positions in a row, m, and of what links remember."""


def _touches(scene: Scene, name: str, numbers: Mapping[str, int]) -> _Touches:
    """Returns the function of a contact. `numbers`: of all points and masses in a row."""
    link = (scene.links | scene.plane_links)[name]
    if link.remembers_touch is not None:
        column, touches = link.remembers_touch
        return lambda _, remembered: bool(remembered[column][name]) == touches
    law, ends = link.table(), [[numbers[one] for one in scene.coordinates_of(end)] for end in link.between]
    assert law is not None  # or it were no contact
    period, begin, free = law.period, law.pieces[0].edge, law.without_force

    def read(places: NDArray[np.float64], _: object) -> bool:
        """Returns whether the two ends are where the law has a force."""
        between = places[ends[0]] - places[ends[1]]
        d = float(between[0]) if between.size == 1 else math.hypot(*between)
        if period:
            d -= period * math.floor((d - begin) / period)
        return not any(low <= d <= high for low, high in free)

    return read
