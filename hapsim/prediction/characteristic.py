"""Static force of a hand whose links all end on grounds, over its position: its edges, rests and pieces.

This is the geometry of the scene alone, without the loop, so that measurements may use it.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.laws import RELEASED, Law, Linear
from hapsim.prediction.linear import LinearScene, linear_scene
from hapsim.scene import Scene
from hapsim.theory.arrays import Floats
from hapsim.units import Units

_ALIKE = 1e-9  # of the largest: relative difference of equal stiffnesses, or of equal edges of a scene
_POINTS = 257  # of a curved piece
_LEVEL = 1e-9  # of the range of the force: a piece that changes it by less is level
_REVERSAL = 0.05  # of the deepest fall: noise of a recording turns back by less
_JUMP = 1e-6  # of the force limit: a larger difference between two pieces is a jump
_AWAY = 0.2  # of a piece's width: a rest that is nearer to its edge is no place for an oscillation
_PRESSED = 0.125  # of the force limit: press into a piece without an end
_WITHIN = 1e-9  # of a piece's width, or of 1 m


class HandLink(NamedTuple):
    """Link between a hand and a ground."""

    law: Law
    sign: float
    """Sign: 1 if the hand is the link's first end, else -1."""
    fixed_m: float
    """Position of the other end, m."""

    def distance(self, x: Floats | float) -> Floats:
        """Distance d of the link for the hand at x, m."""
        return self.sign * (np.asarray(x, float) - self.fixed_m)

    def edges(self, low: float, high: float) -> list[float]:
        """Positions of the hand at the edges of the law, between these two positions, m."""
        ends = sorted(float(self.distance(x)) for x in (low, high))
        return [self.fixed_m + self.sign * d for d in self.law.edges_between(ends[0], ends[1])]

    @property
    def is_regional(self) -> bool:
        """True if the link's spring and damper depend on the position."""
        return bool(self.law.edges) or math.isfinite(self.law.reach) or self.law is RELEASED


class Piece(NamedTuple):
    """Part of the hand's travel in which every link is in one piece of its law, and the same links slide."""

    low: float
    high: float
    """Upper end, m, as ``low`` in the scene's positions; infinite if nothing ends it."""
    place: float
    """Rest, m; or, if there is none, a place well inside."""
    stiffness: float
    """Total K of the scene's links at the place, N/m."""
    damping: float
    """Total B of the same links, N·s/m."""
    states: dict[str, str]
    """State of each link that has several."""
    sliding: tuple[str, ...]
    """Friction links that slide; the others stick."""
    reach: float
    """Movement of the hand around its place, m, until another friction link, or a curve with two branches, slides."""
    is_curved: bool
    branch: str = ""
    """State of curves with two branches: stuck at the "steepest" or "softest" slope, "pressed" or "released"; "": stuck
    in the middle between them."""

    @property
    def is_first(self) -> bool:
        """True if all friction is stuck and every curve between its branches: it is taken where nothing is known."""
        return not self.sliding and not self.branch

    @property
    def within(self) -> tuple[float, float]:
        """Ends of the piece, m, slightly inside: at its release a plectrum's force jumps to the next piece."""
        return _inside(self.low, self.high)


class Flank(NamedTuple):
    """Way along which the force rises, or falls, between two of its turns. Reversals of noise do not count."""

    low: float
    high: float
    """Ends, m."""
    forces: tuple[float, float]
    """Force there, N, of `Characteristic.force`."""
    energy: float
    """If the force falls: energy that a hand gains which pushes through with the steady force of one end, J, in the
    direction in which it gains more."""

    @property
    def stiffness(self) -> float:
        """K over the whole flank, N/m."""
        return (self.forces[1] - self.forces[0]) / (self.high - self.low)


@dataclass(frozen=True)
class Characteristic:
    """Hand whose links all end on grounds.

    Attributes:
        links: by name.
        own_stiffness: of the device's own spring, N/m.
        low, high: m, the device's travel; without one infinite, or two periods of a periodic law.
        force_limit: N.
        count: resolution of a position as the mock sends it, m.
        crossing: m/s, at which a hand crosses a snap at least.
        free: distance of a place from its edge, m, in a piece without an end and without a spring.
        units: of its channel.
        branch: as of its pieces.
    """

    links: dict[str, HandLink]
    own_stiffness: float
    low: float
    high: float
    force_limit: float
    count: float
    crossing: float
    free: float
    units: Units
    branch: str = ""

    @property
    def is_regional(self) -> bool:
        """True if the hand feels different springs and dampers at different places."""
        return any(link.is_regional for link in self.links.values())

    @property
    def period(self) -> float:
        """Period of the whole force, m, if nothing but laws of one period depends on the place; else 0."""
        laws = [one.law for one in self.links.values() if not one.law.is_dry]
        periods = {one.period for one in laws if one.period or one.edges or one.below or one.beyond}
        return periods.pop() if len(periods) == 1 and not self.own_stiffness else 0.0

    def force(self, x: Floats | float, way: Floats | float = 0.0) -> Floats:
        """Force, N, with which the hand at rest at x (m) pushes towards larger x, or at these ways (m) from there, on
        which nothing slides; sticking friction adds none."""
        pulls = [one.sign * one.law.about(one.distance(x), one.sign * way) for one in self.links.values()]
        return np.sum([self.own_stiffness * (np.asarray(x, float) + way), *pulls], axis=0)

    def press(self, x: float) -> float:
        """Force of the scene on the hand at rest at x (m), N."""
        return self.own_stiffness * x - float(self.force(x))

    def moving_force(self, x: Floats, speed: float) -> Floats:
        """The same force while the hand moves at `speed` m/s, friction slides and dampers brake; (N,) as x."""
        force = self.own_stiffness * x
        for link in self.links.values():
            d, parts = link.distance(x), link.sign * speed
            if link.law.is_dry:
                force = force + math.copysign(link.law.slides_at, speed)
            else:
                force = force + link.sign * link.law.pull(d, parts)
        return force

    def stiffness_at(self, x: float) -> float:
        """Stiffness, N/m, of small motions about x, m, with the device's own."""
        return self.own_stiffness + math.fsum(self._linears(x, "stiffness"))

    @cached_property
    def flanks(self) -> tuple[Flank, ...]:
        """Flanks of the force between the outermost edges, by position. A step or a level piece ends one."""
        ends = [one for one in (self.low, *self.edges(), self.high) if math.isfinite(one)]
        if len(ends) < 2:
            return ()
        count = _POINTS if any(one.law.is_curved for one in self.links.values()) else 2
        x = np.array([np.linspace(*_inside(*pair), count) for pair in pairwise(ends)])
        force = self.force(x)
        is_level = np.ptp(force, axis=1) <= _LEVEL * np.ptp(force)
        steps = np.abs(force[1:, 0] - force[:-1, -1]) > _JUMP * self.force_limit
        cuts = count * (np.flatnonzero(steps | is_level[1:] | is_level[:-1]) + 1)
        stretches = [slice(a, b) for a, b in pairwise([0, *cuts.tolist(), x.size])]
        x, force = x.ravel(), force.ravel()
        falls = [np.max(np.maximum.accumulate(force[one]) - force[one], initial=0.0) for one in stretches]
        least = _REVERSAL * float(max(falls))
        turns = ((a + one.start, b + one.start) for one in stretches for a, b in pairwise(_turns(force[one], least)))
        return tuple(self.flank(x[a : b + 1], force[a : b + 1]) for a, b in turns if x[b] > x[a])

    @staticmethod
    def flank(x: Floats, force: Floats) -> Flank:
        """Returns the flank through these positions, m, and forces, N."""
        gains = np.trapezoid(np.max(force) - force, x), np.trapezoid(force - np.min(force), x)
        energy = float(max(gains)) if force[-1] < force[0] else 0.0
        return Flank(float(x[0]), float(x[-1]), (float(force[0]), float(force[-1])), energy)

    def flank_at(self, place: float) -> Flank | None:
        """Returns the flank on which a place, m, is; None beyond the outermost edges."""
        return next((one for one in self.flanks if one.low <= place <= one.high), None)

    def edges(self) -> list[float]:
        """Positions within the travel, m, at which a link passes from one piece of its law to the next."""
        found: list[float] = []
        for name, link in self.links.items():
            try:
                found += link.edges(self.low, self.high)
            except ValueError as too_many:
                where = f"between {self.units.number(self.low, 'm')} and {self.units(self.high, 'm')}"
                expected = "expected a larger pitch, a shorter device.travel, or a position nearer to 0"
                raise UsageError(f"modules.{name}: found {too_many} {where}; {expected}") from None
        alike = _ALIKE * max(map(abs, found), default=0.0)
        kept: list[float] = []
        for edge in sorted(found):
            if self.low < edge < self.high and (not kept or edge - kept[-1] > alike):
                kept.append(edge)
        return kept

    def taken(self, x: float, sliding: Collection[str] = ()) -> dict[str, Linear]:
        """Spring and damper of each link that has several, for the hand at x (m)."""
        here = {name: link for name, link in self.links.items() if link.is_regional}
        slides = Linear(0.0, 0.0)
        return {n: slides if n in sliding else one.law.linear(float(one.distance(x))) for n, one in here.items()}

    def nearest(self, at: float) -> float:
        """Returns the position within the travel that is nearest to `at`, m."""
        return min(max(at, self.low), self.high)

    def pieces(self) -> list[Piece]:
        """Pieces by position; at one place first with every friction link stuck, then with more and more that slide."""
        pieces: list[Piece] = []
        for low, high in pairwise([self.low, *self.edges(), self.high]):
            one = self._piece(low, high)
            last = pieces[-1] if pieces else None
            if last is not None and not self._parts(last, one):
                pieces[-1] = self._piece(last.low, high)
            else:
                pieces.append(one)
        return [variant for piece in pieces for variant in self._with_sliding(piece)]

    def variants(self) -> Iterator[Characteristic]:
        """Yields the hand with its curves of two branches in each other state, those on a branch moving with it."""
        for branch, opposite in (("steepest",) * 2, ("softest",) * 2, ("pressed", "released"), ("released", "pressed")):
            laws = {
                name: one._replace(law=one.law.variants[branch if one.sign > 0.0 else opposite])
                for name, one in self.links.items()
                if one.law.variants
            }
            if laws:
                yield replace(self, links=self.links | laws, branch=branch)

    def _parts(self, last: Piece, one: Piece) -> bool:
        """Returns whether two pieces that follow each other are not one: by their springs, or the force jumps there."""
        if one.is_curved or last.is_curved or not _are_alike(last, one):
            return True
        jumps = any(not link.law.memoryless and math.isinf(link.law.reach) for link in self.links.values())
        if not jumps:
            return False
        before, after = (float(self.force(x)) for x in (last.within[1], one.within[0]))
        return abs(after - before) > _JUMP * self.force_limit

    def at(self, x: float, pieces: list[Piece]) -> Piece:
        """Returns the piece at x (m) with all friction stuck; on an edge the stiffer one."""
        here = [one for one in pieces if one.low <= x <= one.high and not one.sliding]
        return max(here, key=lambda one: one.stiffness)

    def held(self, pieces: list[Piece]) -> Piece | None:
        """Returns the piece that holds the hand nearest to position 0, by its rest if it has one; None if none does."""
        holding = [one for one in pieces if one.stiffness + self.own_stiffness > 0.0 and not one.sliding]
        resting = [one for one in holding if self.rest(one) is not None]

        def way(one: Piece) -> tuple[float, float]:
            rest = self.rest(one)
            nearest = min(max(0.0, one.low), one.high) if rest is None else rest
            return abs(nearest), -one.stiffness

        return min(resting or holding, key=way, default=None)

    def rest(self, piece: Piece) -> float | None:
        """Rest of a hand that does not push in this piece, its ends included, m; None if there is none."""
        return self._rest(piece.low, piece.high, piece.is_curved)

    def _rest(self, low: float, high: float, is_curved: bool) -> float | None:
        if is_curved and math.isfinite(high - low):
            from scipy.optimize import brentq

            low, high = _inside(low, high)
            ends = float(self.force(low)), float(self.force(high))
            return float(brentq(self.force, low, high, xtol=1e-15)) if ends[0] * ends[1] < 0.0 else None
        inner = _within(low, high)
        # Sticking dry friction has no force at rest, and so no effect on its place.
        springs = (one for one in self.links.values() if math.isinf(one.law.reach))
        slope = self.own_stiffness + math.fsum(one.law.slope(float(one.distance(inner))) for one in springs)
        x = inner - float(self.force(inner)) / slope if slope else math.nan
        near = _ALIKE * max(abs(low) if math.isfinite(low) else 0.0, abs(high) if math.isfinite(high) else 0.0)
        return min(max(x, low), high) if low - near <= x <= high + near else None

    def _linears(self, x: float, what: str) -> list[float]:
        return [getattr(one.law.linear(float(one.distance(x))), what) for one in self.links.values()]

    def _piece(self, low: float, high: float) -> Piece:
        inner = _within(low, high)
        states = {n: one.law.state(float(one.distance(inner))) for n, one in self.links.items() if one.is_regional}
        is_curved = any(one.law.is_curved for one in self.links.values())
        place = self._place(low, high, is_curved)
        stiffness, damping = (math.fsum(self._linears(place, what)) for what in ("stiffness", "damping"))
        reach = min((one.law.reach for one in self.links.values()), default=math.inf)
        return Piece(low, high, place, stiffness, damping, states, (), reach, is_curved, self.branch)

    def _place(self, low: float, high: float, is_curved: bool) -> float:
        width = high - low
        rest = self._rest(low, high, is_curved)
        if rest is not None and min(rest - low, high - rest) > (_AWAY * width if math.isfinite(width) else 0.0):
            return rest
        if math.isfinite(width):
            return 0.5 * (low + high)
        edge, way = (low, 1.0) if math.isfinite(low) else (high, -1.0)
        if not math.isfinite(edge):
            return 0.0
        slope = self.stiffness_at(_within(low, high))
        return edge + way * (_PRESSED * self.force_limit / slope if slope > 0.0 else self.free)

    def _with_sliding(self, piece: Piece) -> list[Piece]:
        rubs = sorted((one.law.reach, n) for n, one in self.links.items() if one.law.is_dry)
        variants = [piece]
        for i in range(1, len(rubs) + 1):
            sliding = tuple(name for _, name in rubs[:i])
            taken = [self.links[name].law.linear(0.0) for name in sliding]
            variants.append(
                piece._replace(
                    stiffness=piece.stiffness - math.fsum(one.stiffness for one in taken),
                    damping=piece.damping - math.fsum(one.damping for one in taken),
                    states=piece.states | dict.fromkeys(sliding, "sliding"),
                    sliding=sliding,
                    reach=rubs[i][0] if i < len(rubs) else math.inf,
                )
            )
        return variants


def _turns(force: Floats, least: float) -> list[int]:
    """Returns the indices at which a curve turns by more than `least`, with its first and its last."""
    turns, extreme, rises = [0], 0, 0
    for i, here in enumerate(force.tolist()):
        way = here - force[extreme]
        if rises == 0 and abs(way) > least:
            extreme, rises = i, 1 if way > 0.0 else -1
        elif rises * way >= 0.0:
            extreme = i if rises else extreme
        elif abs(way) > least:
            turns.append(extreme)
            extreme, rises = i, -rises
    ends = [extreme, len(force) - 1] if rises else [len(force) - 1]
    return [*turns, *(one for one in dict.fromkeys(ends) if one > turns[-1])]


def _are_alike(one: Piece, other: Piece) -> bool:
    both = (one.stiffness, other.stiffness), (one.damping, other.damping)
    return all(abs(a - b) <= _ALIKE * max(abs(a), abs(b)) for a, b in both)


def _inside(low: float, high: float) -> tuple[float, float]:
    within = _WITHIN * min(high - low, 1.0)
    return low + within, high - within


def _within(low: float, high: float) -> float:
    """Returns a place between the two; either may be infinite."""
    if math.isfinite(low) and math.isfinite(high):
        return 0.5 * (low + high)
    if math.isfinite(low):
        return low + max(1.0, abs(low))
    return high - max(1.0, abs(high)) if math.isfinite(high) else 0.0


def characteristic_of(scene: Scene, name: str, around: float = 0.0, wherever: bool = False) -> Characteristic | None:
    """Returns the characteristic of the hand at this device point; None if one of its links ends on a mass or on
    another hand, or if it moves in the plane. A periodic law without a travel is covered by whole pieces within a
    period from position 0, and from `around` (m). `wherever`: the hand's position at the start is unknown."""
    if len(scene.device_points) > len(scene.channel_groups):
        return None
    links: dict[str, HandLink] = {}
    for link_name, link in scene.links.items():
        if name in link.between:
            first, second = link.between
            other = second if first == name else first
            if other not in scene.grounds:
                return None
            links[link_name] = HandLink(link.law(), 1.0 if first == name else -1.0, scene.grounds[other].position)
    device, channel = scene.device, scene.device_points[name].channel
    low, high = device.travels(scene.channels)[channel]
    start = None if wherever else starts_at(scene, channel)
    # A plectrum that neither grips at the hand's start nor is passed within the travel is always released.
    if start is not None:
        for link_name, one in links.items():
            grips_there = not one.law.grips or abs(float(one.distance(start))) <= one.law.edges[-1]
            if not grips_there and not low <= one.fixed_m <= high:
                links[link_name] = one._replace(law=RELEASED)
    repeats = [one for one in links.values() if one.law.period]
    if repeats and not (math.isfinite(low) and math.isfinite(high)):
        period = max(one.law.period for one in repeats)
        others = [one.fixed_m + one.sign * d for one in links.values() if not one.law.period for d in one.law.edges]
        low, high = min([-period, around - period, *others]), max([period, around + period, *others])
        ends = [
            edge
            for one in repeats
            for begin in (low, high - one.law.period)
            for edge in one.edges(begin, begin + one.law.period)
        ]
        low, high = min(ends), max(ends)
    own, scale = device.stiffnesses(scene.channels)[channel], device.scales(scene.channels)[channel]
    count = scene.mock_device.quantum[channel]
    at = scale.crossing, scale.free, scene.units_of(channel)
    return Characteristic(links, own, low, high, device.force_limit, count, *at)


def starts_at(scene: Scene, channel: int) -> float | None:
    """Position of the hand on this channel at arming, m; None if it depends on a device at a port."""
    origin = scene.device.origins(scene.channels)[channel]
    if origin is None:
        return 0.0
    return None if scene.device.port is not None else scene.mock_device.initial_position[channel] - origin


def hand_at(scene: Scene, name: str) -> Characteristic:
    """Returns `characteristic_of` a hand that has one."""
    found = characteristic_of(scene, name)
    assert found is not None
    return found


def scene_at(scene: Scene, at: float | None = None, instead: Mapping[str, Linear] | None = None) -> LinearScene:
    """Returns the linear form of `scene` at the positions of its hands, by the piece that each is in; `instead`
    replaces the forms of some links. Each hand that reaches `at` (m) is there. The others, and all of them without
    `at`, are at rest or held nearest to position 0; in admittance, in which the hand holds itself, nearest to position
    0 [default]. Links that move masses or other hands are then as their assumptions state. UsageError if no hand
    reaches it."""
    taken: dict[str, Linear] = {}
    alone = {name: characteristic_of(scene, name, at or 0.0) for name in scene.device_points}
    if at is not None and None in alone.values():
        from hapsim.prediction.reach import links_at_rest

        taken |= links_at_rest(scene, dict.fromkeys(alone, at))
    hands = {name: one for name, one in alone.items() if one is not None and one.is_regional}
    reached = [name for name, one in hands.items() if at is not None and one.low <= at <= one.high]
    for name, one in hands.items():
        # If no hand reaches it, the first raises.
        place = at if name in reached or not reached else None
        if place is None and scene.device.is_admittance:
            place = one.nearest(0.0)
        taken |= one.taken(piece_at(one, name, place).place)
    return linear_scene(scene, taken | dict(instead or {}))


def simulated_places(scene: Scene, at: float | None) -> list[str]:
    """Sentences on the assumed position of each simulated mass that feels different springs at different places."""
    found = []
    for name in scene.device_points:
        one = characteristic_of(scene, name, at or 0.0)
        if one is not None and one.is_regional:
            place = one.nearest(at or 0.0)
            states = ", ".join(f"{link} is {state}" for link, state in piece_at(one, name, place).states.items())
            found.append(f"{name} is held at {one.units(place, 'm')}, where {states}")
    return found


def places_of(scene: Scene) -> list[str]:
    """Sentences on the assumed position in `scene_at` of each hand that feels different springs at different places."""
    hands = ((name, characteristic_of(scene, name)) for name in scene.device_points)
    pieces = ((name, piece_at(one, name)) for name, one in hands if one is not None and one.is_regional)
    return [
        f"{name} is in the region where {', '.join(f'{link} is {state}' for link, state in piece.states.items())}"
        for name, piece in pieces
    ]


def piece_at(one: Characteristic, name: str, at: float | None = None) -> Piece:
    """Returns the piece of the hand `name` at `at` m [default: one that holds it]. UsageError beyond the travel."""
    pieces = one.pieces()
    if at is None:
        return one.held(pieces) or one.at(one.nearest(0.0), pieces)
    if not one.low <= at <= one.high:
        found = f"found {one.units(at, 'm')}, outside the travel of {name}"
        reach = f"{one.units.number(one.low, 'm')} to {one.units(one.high, 'm')}"
        raise UsageError(f"at: {found}; expected a position from {reach}")
    piece = one.at(at, pieces)
    low, high = piece.within  # on an edge a slope would be the mean of two
    return piece._replace(place=min(max(at, low), high))


def linear_at(hand: Characteristic, linear: LinearScene, piece: Piece) -> LinearScene:
    """Returns `linear`, a scene in linear form, with this hand of it in this piece."""
    taken = hand.taken(piece.place, piece.sliding)
    here = {
        link: linear.links[link]._replace(stiffness=one.stiffness, damping=one.damping) for link, one in taken.items()
    }
    return linear._replace(links=linear.links | here)
