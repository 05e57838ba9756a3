"""Prediction of a scene in the plane: it is linear about the places of its points, with its masses at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

from hapsim.errors import UsageError
from hapsim.prediction.linear import LinearLink, linear_scene, network_of
from hapsim.prediction.part import Along
from hapsim.prediction.plane_geometry import Plane
from hapsim.prediction.plane_states import PlaneJudge, PlaneStates, Slide, directions, held, slides_of, with_links
from hapsim.prediction.prediction import AT_LIMIT, SLIDES, Prediction
from hapsim.scene import Scene
from hapsim.scene.chain import Point
from hapsim.scene.outlines import travel_boundary, travel_in_words
from hapsim.theory import Margins, margins_of

_SAMPLES = 256  # along a line
_WITHIN = 0.382  # of the way to the next sample: seldom on the edge of a link
_HALVINGS = 30


class PlanePrediction(Prediction):
    """Prediction of a scene in the plane; `at` is the place of the first hand, m, or places by hand."""

    def _take(self, _instead: object = None) -> None:
        self._plane = plane = Plane(self._seen)
        self.hands = plane.hands
        hands = {name: plane.start[name] for name in plane.hands}
        if self._at is not None:
            at = self._at if isinstance(self._at, Mapping) else {plane.hands[0]: self._at}
            hands |= {name: self._require_reached(name, place) for name, place in at.items()}
        rest = plane.at_rest(hands)
        self.places, self._rests = plane.start | hands if rest is None else rest, rest is not None
        self.links = plane.at(self.places)
        points = linear_scene(self._seen)
        bare, self.points = network_of(self._seen, points)
        self._also = [[self.points.index(f"{name}.{axis}") for axis in "xy"] for name in plane.hands]
        self.network = with_links(bare, self.points, self.links)
        linear = {one.name: LinearLink(one.link.between, one.slope, one.damping) for one in self.links}
        self._linear = points._replace(links=linear, assumptions=[*self._assumed()])
        self.states = PlaneStates(plane, bare, self.points, self.places)  # type: ignore[assignment]

    def _coupling_reason(self, _name: str) -> str:
        return "moves in the plane"

    def _require_reached(self, name: str, at: Any) -> Point:
        """Returns the place of a hand. Raises UsageError beyond its travel."""
        x, y = at
        channel, units = self.scene.device_points[f"{name}.x"].channel, self.scene.units
        if (travel := travel_boundary(self.scene, self.scene.hand_of(channel))) is not None:
            (about_x, about_y), boundary = travel
            if (outside := boundary.nearest(x - about_x, y - about_y).distance) > 0.0:
                place, beyond = f"{units.number(x, 'm')},{units(y, 'm')}", units(outside, "m", 3)
                goes = f"which goes {travel_in_words(self.scene, channel)}"
                raise UsageError(f"at: found {place}, {beyond} outside the travel of {name}, {goes}")
        return x, y

    def _assumed(self) -> Iterator[str]:
        if not self._rests:
            yield "masses are taken where they start: no rest of them was found"
        yield from (f"{one.name} sticks, without a force along its surface" for one in self.links if one.rubs)

    @cached_property
    def judge(self) -> PlaneJudge:
        return PlaneJudge(self.network, self.points, False, {}, (), self.states)

    @cached_property
    def slides(self) -> tuple[Slide, ...]:
        """Motions that the scene drives without an oscillation, the fastest first."""
        return slides_of(self.network, self.points, self.judge.solved.solution)

    @cached_property
    def directions(self) -> tuple[int, int]:
        """Numbers of directions in which the scene drives its points on, and without a stiffness."""
        return directions(self.network)

    @property
    def verdict_here(self) -> str:
        if self.judge.shaken_by_network() is not None:
            return "unstable"
        return SLIDES if self.slides else "stable" if self.stable_as_taken else AT_LIMIT

    @property
    def is_held(self) -> bool:
        hand = self.hands[0]
        acts = any(one.acts and hand in one.link.between for one in self.links)
        return acts and self.verdict_here != SLIDES and not self._plane.in_the_way(hand, self.places[hand])

    @cached_property
    def _margins(self) -> Margins:
        """Margins of what shakes: what slides is held."""
        if not self._with_margins or not self.directions[0]:
            return super()._margins
        return margins_of(held(self.network))


class Stretch(NamedTuple):
    """Part of a line along which a hand touches the same pieces of the same links, with one verdict."""

    begin: Point
    end: Point
    middle: PlanePrediction

    @property
    def felt(self) -> list[Along]:
        """Rows of what the first hand feels in the middle, along its principal directions."""
        (first, *_), one = self.middle.hands, self.middle.parts[0]
        return one.along(first)

    @property
    def links(self) -> dict[str, str]:
        """States of the links that act, by name."""
        return {one.name: one.state for one in self.middle.links if one.acts}


def stretches_along(scene: Scene, begin: Point, end: Point) -> list[Stretch]:
    """Returns the stretches along a line of the first hand, in their order: found at some hundred places, and their
    ends by halving."""

    def place(share: float) -> Point:
        return begin[0] + share * (end[0] - begin[0]), begin[1] + share * (end[1] - begin[1])

    def at(share: float) -> PlanePrediction:
        return PlanePrediction(scene, place(share), with_margins=False)

    def kind(share: float) -> object:
        here = at(share)
        verdict = SLIDES if here.directions[0] and here.verdict_here != "unstable" else here.verdict_here
        return [(one.name, one.piece, one.state) for one in here.links if one.acts], verdict

    shares = [(i + _WITHIN) / _SAMPLES for i in range(_SAMPLES)]
    edges, low, before = [0.0], shares[0], kind(shares[0])
    for share, now in zip(shares[1:], map(kind, shares[1:]), strict=True):
        while now != before:
            high = share
            for _ in range(_HALVINGS):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if kind(middle) == before else (low, middle)
            edges.append(high)
            low, before = high, kind(high)
        low = share
    return [Stretch(place(a), place(b), at(0.5 * (a + b))) for a, b in pairwise([*edges, 1.0])]
