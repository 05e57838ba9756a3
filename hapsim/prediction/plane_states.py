"""Motions of a scene in the plane at places where its links touch: shakes, slides, and directions without a force.

A place at which negative stiffness drives a point on, such as a round surface pressed from outside, slides: it has a
real pole. A shake is what grows beside it. A hand may be anywhere, so the places judged are along each surface and
path, and around each point, as deep as the force limit presses; the other points rest, or are where they start.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain, product
from typing import ClassVar, NamedTuple

import numpy as np

from hapsim.laws import Law, Linear
from hapsim.prediction.memory import VERDICTS, content_of
from hapsim.prediction.plane_geometry import Plane, PlaneLink, as_row
from hapsim.prediction.stability import Judge
from hapsim.prediction.states import Grown
from hapsim.prediction.swings import UNNOTICED, NetworkVerdict, Shaking, Swing
from hapsim.scene.chain import Piece, Point
from hapsim.theory import Network, Solution
from hapsim.theory.network import loop, state_size
from hapsim.theory.network.felt import matrices
from hapsim.units import Units

_DEEP = 1e-4  # m, into a surface
_TURN = 0.5  # rad, from place to place on an arc
_ANGLES = 8  # around a point
_ALIKE = 0.05  # rad, of two directions
_NONE = 1e-12  # of the largest stiffness: rounding
_MOST_PLACES = 256  # that are judged
_WORK = 4e9  # cubes of sizes of states: some seconds on one core, which long delays take

Places = Mapping[str, Point]


class Slide(NamedTuple):
    """Motion that negative stiffness drives: it grows without an oscillation."""

    module: str
    """Module that moves most in it."""
    angle_deg: float
    """Direction in which it moves, from x towards y; 0 <= angle < 180."""
    pole: float
    e_fold_s: float
    """Time in which it grows e-fold, s."""


def with_links(
    bare: Network, points: tuple[str, ...], links: Sequence[PlaneLink], sliding: Mapping[str, int] | None = None
) -> Network:
    """Returns the network with these links. `sliding`: the direction, 1 or -1, of friction that slides, by name."""
    column = {name.removesuffix(".x"): i for i, name in enumerate(points) if name.endswith(".x")}
    rows = [
        (i, one.link, row)
        for i, one in enumerate(links)
        for row in one.rows((sliding or {}).get(one.name if one.corner is None else one.corner.first, 0))
    ]
    size = len(points)
    return replace(
        bare,
        rows=np.array([as_row(link, row.stretch, column, size) for _, link, row in rows]).reshape(-1, size),
        pulls=np.array([as_row(link, row.pull, column, size) for _, link, row in rows]).reshape(-1, size),
        stiffness=np.array([row.stiffness for *_, row in rows]),
        damping=np.array([row.damping for *_, row in rows]),
        link_of_row=np.array([i for i, *_ in rows], np.intp),
        margin_links=len(links),
        damper=(),
        outside=(),
    )


def directions(network: Network) -> tuple[int, int]:
    """Returns the numbers of directions in which the scene drives its points on, and without a stiffness."""
    *_, K = matrices(network)
    values = np.linalg.eigvals(K)
    least = _NONE * np.abs(values).max(initial=0.0)
    real = np.abs(values.imag) <= least
    return int((real & (values.real < -least)).sum()), int((np.abs(values) <= least).sum())


def slides_of(network: Network, points: tuple[str, ...], solution: Solution) -> tuple[Slide, ...]:
    """Returns the slides that a hand notices, the fastest first."""
    count, _ = directions(network)
    if not count or solution.eigen is None:
        return ()
    w, states = solution.eigen
    moved, found = (loop(network).points @ states).real, []
    drives = [i for i in np.argsort(-w.real) if abs(w[i].imag) <= _NONE and w[i].real > 0.0]
    for i in drives[:count]:
        name = points[int(np.abs(moved[:, i]).argmax())][:-2]
        x, y = (moved[points.index(f"{name}.{axis}"), i] for axis in "xy")
        angle = math.degrees(math.atan2(y, x)) % 180.0
        efold = 1.0 / (float(np.log1p(w[i].real)) * network.rate)
        if efold >= UNNOTICED:
            break
        found.append(Slide(name, 0.0 if 180.0 - angle < _NONE else angle, 1.0 + float(w[i].real), efold))
    return tuple(found)


def held(network: Network) -> Network:
    """Returns the network without its negative stiffnesses: what slides is held."""
    drives = (network.stiffness < 0.0) & (np.asarray(network.rows) == np.asarray(network.pulls)).all(axis=1)
    return replace(network, stiffness=np.where(drives, 0.0, network.stiffness))


class PlaneVerdict(NetworkVerdict):
    """Growing motions of a scene in the plane."""

    @cached_property
    def snaps(self) -> int:
        return directions(self.network)[0]

    @property
    def rests(self) -> int:
        return sum(directions(self.network))


class PlaneJudge(PlaneVerdict, Judge):
    """Verdict on a scene in the plane."""

    @cached_property
    def is_stable_as_taken(self) -> bool:
        return self.settles

    @cached_property
    def _grown(self) -> list[Grown]:
        every = [one for one in (self.shaken_by_network(), *self.states.growing) if one is not None]
        return [Grown(one, [], []) for one in sorted(every, key=lambda one: -one.growth)[:1]]

    def _swing_of_part(self, _number: int) -> Swing | None:
        return None


@dataclass(frozen=True, eq=False)
class _Touch:
    """Places at which links touch. `sliding`: the direction of friction that slides. `key`: equal for like places."""

    bare: Network
    points: tuple[str, ...]
    units: Units
    hand: str
    places: Places
    links: Sequence[PlaneLink]
    sliding: Mapping[str, int]
    key: object

    @cached_property
    def shaken(self) -> Shaking | None:
        """Motion that grows there."""
        links, sliding, hand = self.links, self.sliding, self.hand
        verdict = PlaneVerdict(with_links(self.bare, self.points, links, sliding), self.points)
        shaken = verdict.shaken_by_network()
        how = ", ".join(
            f"{one.name} {'slides' if one.name in sliding else f'is {one.state}'}" for one in links if one.state
        )
        where = ", ".join(self.units.number(one, "mm", 4) for one in self.places[hand])
        how += f"{' with ' if how else ''}{hand} {'' if how else 'is '}at {self.units(where, 'mm')}"
        return shaken and shaken._replace(state=how)


@dataclass(eq=False)
class PlaneStates:
    """Places at which the links of a scene in the plane touch, judged when needed, in place of `ContactStates`.

    Attributes:
        plane: the scene. bare, points: its points without links, and their names.
        places: of the points where the scene is linearised.
    """

    plane: Plane
    bare: Network
    points: tuple[str, ...]
    places: Places
    parts: ClassVar = ()
    is_complete: ClassVar = True

    def instead(self, _is_free: bool) -> dict[str, Linear]:
        """Links to take otherwise than they are: none."""
        return {}

    @property
    def count(self) -> int:
        """Number of unlike places, up to `_MOST_PLACES`."""
        return len(self._verdicts[0]) + self.unjudged

    @property
    def unjudged(self) -> int:
        """Number of those that would take too long."""
        return self._verdicts[1]

    @property
    def growing(self) -> list[Shaking]:
        """Motions that surely grow."""
        return list(dict.fromkeys(one for one in self._verdicts[0].values() if one is not None))

    @property
    def words(self) -> str:
        """Phrase that follows "stable" or "unstable" and limits the verdict."""
        if self.growing:
            return f"while {max(self.growing, key=lambda one: one.growth).state}"
        return f"at {self.count} unlike places where its links touch; others are not judged (--at, --along)"

    @property
    def acting(self) -> set[str]:
        """Links that act at every place at which a motion grows: a change of another one does not help everywhere."""
        return self._verdicts[2]

    @cached_property
    def _verdicts(self) -> tuple[dict[object, Shaking | None], int, set[str]]:
        """Motion that grows at each unlike place, by what makes it unlike; how many are beyond `_WORK`; `acting`."""
        found: dict[object, Shaking | None] = {}
        acting = {*self.plane.links}
        beyond: set[object] = set()
        most = min(_MOST_PLACES, 1 + int(_WORK / state_size(self.bare) ** 3))
        here = self._touches(self.places, self.plane.near(self.places))
        for touch in chain(here, *map(self._unlike, self.plane.links)):
            if touch.key in found or len(found) >= most:
                beyond.update({touch.key} - found.keys() if most < _MOST_PLACES else ())
                continue
            shaken = found[touch.key] = touch.shaken
            acting &= {one.name for one in touch.links} if shaken else acting
        return found, len(beyond), acting

    @cached_property
    def _content(self) -> bytes:
        """Digest of all that a place depends on beside the links that are near it."""
        plane, outlines = self.plane, [one.outline for one in self.plane.surfaces]
        return content_of(self.bare, self.points, self.places, plane.scene.device, outlines, [*plane.links])

    def _unlike(self, name: str) -> list[_Touch]:
        """Returns the unlike places at which this link touches, each with the first of its kind. They are remembered
        while the links near them are what they were."""
        links = {at: link for at, (link, _) in self.plane.links.items()}
        found: list[_Touch] = VERDICTS.recall((self._content, name), lambda: self._found(name), links)
        return found

    def _found(self, name: str) -> tuple[list[_Touch], set[str]]:
        """Returns these, and the names of the links that are near one of the places."""
        found, names = dict[object, _Touch](), {name}
        for places in self._touching(name):
            near = self.plane.near(places)
            names |= {one.name for one in near if one.on is None or one.distance < 0.0}  # no other shape acts there
            for touch in self._touches(places, near):
                found.setdefault(touch.key, touch)
        return [*found.values()], names

    def _touches(self, places: Places, near: Sequence[PlaneLink]) -> Iterator[_Touch]:
        """Yields a place with all friction stuck, and with each friction that can slide."""
        links = [one for one in near if one.acts]
        of_all = self.bare, self.points, self.plane.units, self.plane.hands[0], places, links
        key = self._key(links)
        yield _Touch(*of_all, {}, key)
        for i, way in product((i for i, one in enumerate(links) if one.rubs), (1, -1)):
            yield _Touch(*of_all, {links[i].name: way}, (i, way, key))

    def _key(self, links: Sequence[PlaneLink]) -> object:
        """Returns equal keys for links that differ by a turn of all, if every hand is the same in all directions."""
        bare, turned = self.bare, [one for one in links if one.link.holds_across != "always"]
        normals = {one.name: [one.normal] if one.corner is None else [one.normal, one.corner.normal] for one in turned}
        angles = {name: [math.atan2(y, x) for x, y in each] for name, each in normals.items()}
        of_hands = bare.channel_mass, bare.channel_friction, bare.channel_stiffness
        is_round = bare.mass_coupling is None and all((one[::2] == one[1::2]).all() for one in of_hands)
        first = next(iter(angles.values()), [0.0])[0] if is_round else 0.0
        return tuple(
            (*one.link.between, one.rubs and one.link, one.slope, one.damping,
             f"{one.across:.2g}", *(round(math.remainder(angle - first, 2.0 * math.pi) / _ALIKE)
                                    for angle in angles.get(one.name, ())))
            for one in links
        )  # fmt: skip

    def _touching(self, name: str) -> Iterator[Places]:
        """Yields places of the points at which a link touches, within the travel of the hands."""
        scene, at, (link, law) = self.plane.scene, self.places, self.plane.links[name]
        travels, moving = scene.device.travels(scene.channels), {*self.plane.hands, *self.plane.masses}
        moved, other, side = (*link.between, 1.0) if link.between[0] in moving else (*link.between[::-1], -1.0)
        hand = (scene.device_points.get(f"{moved}.{axis}") for axis in "xy")
        ends = [travels[one.channel] for one in hand if one is not None]
        spots = _spots(self.plane.pieces(name))
        for d, ((px, py), (nx, ny)) in product(_distances(law, scene.device.force_limit), spots):
            place = at[other][0] + side * (px + d * nx), at[other][1] + side * (py + d * ny)
            if all(low <= value <= high for (low, high), value in zip(ends, place, strict=False)):
                yield {**at, moved: place}


def _spots(pieces: Sequence[Piece] | None) -> list[tuple[Point, Point]]:
    """Returns places of a link's first end by its second, m, and its normal there; None: where the ends meet."""
    if pieces is None:
        turns = [2.0 * math.pi * i / _ANGLES for i in range(_ANGLES)]
        return [((0.0, 0.0), (math.cos(turn), math.sin(turn))) for turn in turns]
    found = []
    for piece in pieces:
        if math.isinf(piece.extent):
            found.append(((piece.x, piece.y), piece.normal(0.0)))
            continue
        steps = 2 * math.ceil(piece.extent / _TURN) if piece.bend else 2
        shares = [i / steps for i in (*range(1, steps, 2), *range(0, steps + 1, 2))]
        shares = [0.5] if piece.bend and not piece.radius else shares
        found += [(piece.at(share), piece.normal(share)) for share in shares]
    return found


def _distances(law: Law, force_limit: float) -> Iterator[float]:
    """Yields distances, m, in each piece of a law that acts."""
    for piece, high in zip(law.pieces, [*(one.edge for one in law.pieces[1:]), math.inf], strict=True):
        most = force_limit / piece.slope if piece.slope > 0.0 else _DEEP
        edge, way = (high, -1.0) if math.isfinite(high) else (piece.edge, 1.0)
        edge = edge if math.isfinite(edge) else law.knots[0][0]
        if piece.slope or piece.damping:
            yield from (edge + way * min(one, 0.5 * (high - piece.edge)) for one in (_DEEP, most))
