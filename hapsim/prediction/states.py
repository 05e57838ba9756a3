"""The states that a scene's contacts, plectra, tables and dry friction can be in, and what moves in each.

A state says of every such link in which piece of its law it is. It can occur where the positions allow it: hands within
their travel, masses as far from where they begin as springs let them. What holds a point by springs lets it go twice as
far as the force limit deflects them at rest, and back through a stretch that they begin with. Links between a ground
and a hand that moves nothing else are not among them: that hand has regions (`stability.Region`).
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterator
from dataclasses import replace
from functools import cached_property
from itertools import islice, pairwise
from typing import NamedTuple

import numpy as np

from hapsim.laws import Law, Linear
from hapsim.prediction.linear import LinearScene, mixes_dampers, why_coupled
from hapsim.prediction.shaking import NetworkVerdict, Shaking
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.arrays import Bools, Floats, Indices
from hapsim.theory.network import LARGE, never_grows, part_of, part_of_each, state_size
from hapsim.theory.rows import stretches_of

MOST_STATES = 1024
"""Looked for in a part of the scene."""
_WORK = 4e8  # cubes of sizes of states: half a second on one core
_OF_STATE = 4e5  # of one of which nothing has to be worked out
_OF_EACH = 90.0  # added to the size: the time that does not grow with it
_OF_LARGE = 1.6e5  # times the size of a large one
_FIXED = "."  # whatever stays where it is; no point is called so
_MOST_CONTACTS = 64  # of a part
_MEETS = 1e-12  # m: what overlaps by less does not


class Option(NamedTuple):
    """A piece of a link's law, in which it is this spring and damper: its distance is between these two, m."""

    state: str
    linear: Linear
    low: float = -math.inf
    high: float = math.inf
    through: bool = False
    """Whether its ends have to meet before."""
    moved: float = 0.0
    """By how much its ends have to move before, m."""

    @property
    def acts(self) -> bool:
        """Whether it is a spring or a damper at all."""
        return self.linear.stiffness != 0.0 or self.linear.damping != 0.0


def options_of(law: Law) -> tuple[Option, ...]:
    """The pieces that a link of this law can be in, alike neighbours as one; one for a link that is always the same."""
    here = law.linear()
    pieces = [(piece, here._replace(stiffness=piece.slope, damping=piece.damping)) for piece in law.pieces]
    if math.isfinite(law.reach):
        return Option("stuck", here), Option("sliding", here._replace(stiffness=0.0, damping=0.0), moved=law.reach)
    if law.grips:
        (_, gripping, _), edge = pieces, law.edges[-1]
        free = here._replace(stiffness=0.0, damping=0.0)
        return Option("gripping", gripping[1], -edge, edge, through=True), Option("released", free)
    ends = [(piece.edge, after.edge) for (piece, _), (after, _) in pairwise(pieces)]
    ends.append((pieces[-1][0].edge, math.inf))
    if law.period:
        ends = [(-math.inf, math.inf)] * len(pieces)
    found: list[Option] = []
    for (piece, linear), (low, high) in zip(pieces, ends, strict=True):
        if found and (found[-1].linear, found[-1].state) == (linear, piece.state):
            found[-1] = found[-1]._replace(high=high)
        elif not law.period or linear not in [one.linear for one in found]:
            found.append(Option(piece.state, linear, low, high))
    return tuple(found)


State = dict[str, Option]
"""How each link of a part of the scene is, by name."""


class ContactStates:
    """Those of a scene's links that are not the same everywhere, judged where that is asked for.

    Attributes:
        parts: of the scene, that no link joins: for each the states that can occur.
        is_complete: False where a part has more of them than are looked for.
    """

    def __init__(self, scene: Scene, linear: LinearScene, network: Network, points: tuple[str, ...]) -> None:
        """`linear`, `network`, `points`: the scene as it is taken."""
        self._network, self._points, self._links = network, points, linear.links
        hands = (name for name in scene.device_points if not why_coupled(scene, linear, name))
        alone = {name for name in hands if not mixes_dampers(scene, name)}
        self._ends = dict(zip(linear.links, network.ends.tolist(), strict=False))
        moving = (name for name, (first, second) in self._ends.items() if first != second)  # not two grounds, -1
        own = (name for name in moving if not {*linear.links[name].between} & alone)
        every = ((name, options_of(scene.links[name].law())) for name in own)
        options = {name: found for name, found in every if len(found) > 1}
        self.parts: list[list[State]] = []
        self.is_complete = True
        if not options:
            return
        self._reach = _Reach(scene, linear, options)
        self._options = {name: self._reach.met(linear.links[name].between, found) for name, found in options.items()}
        part, names_of = part_of_each(network.ends, len(points)), dict[int, list[str]]()
        for name in options:
            names_of.setdefault(int(part[max(self._ends[name])]), []).append(name)
        for names in names_of.values():
            found: list[State] = []
            if len(names) <= _MOST_CONTACTS:
                found += islice(self._possible(names, self._reach.apart), MOST_STATES + 1)
            self.is_complete &= len(names) <= _MOST_CONTACTS
            self.is_complete &= len(found) <= MOST_STATES
            self.parts.append(found[:MOST_STATES])

    @property
    def count(self) -> int:
        """How many states were found that can occur."""
        return sum(map(len, self.parts))

    @property
    def shaking(self) -> Shaking | None:
        """What surely grows most in a state that was judged."""
        return max(self.growing, key=lambda one: one.growth, default=None)

    @property
    def growing(self) -> list[Shaking]:
        """What surely grows, of each state in which something does."""
        return self._verdicts[0]

    @property
    def unjudged(self) -> int:
        """How many of the states found were not judged, for want of time; 1 at least where more can occur."""
        return max(self._verdicts[1], int(not self.is_complete))

    @property
    def words(self) -> str:
        """Where the verdict holds, in words that follow "stable" or "unstable"; "" where there is one state."""
        if self.shaking is not None:
            return f"while {self.shaking.state}"
        if self.unjudged:
            return "as its contacts are taken, not judged in every state of them"
        return f"in all {self.count} states of its contacts; bounces are not judged" if self.count > 1 else ""

    def instead(self) -> dict[str, Linear]:
        """The links that cannot be as they are taken while those before them are, and how they are then."""
        found: dict[str, Linear] = {}
        for names in (part[0] for part in self.parts if part):
            apart = self._reach.apart
            for name in names:
                options, between = self._options[name], self._links[name].between
                taken = [one for one in options if self._is_taken(name, one)]
                limits = [(one, self._reach.limited(apart, between, one)) for one in (*taken, *options) if taken]
                one, nearer = next(((one, limit) for one, limit in limits if limit is not None), (None, None))
                apart = apart if nearer is None else nearer
                if one is not None and one not in taken:
                    words = f"is taken as {one.state}: it cannot be {taken[0].state} while those before it are as taken"
                    found[name] = one.linear._replace(assumption=words)
        return found

    def _is_taken(self, name: str, option: Option) -> bool:
        link = self._links[name]
        return (option.linear.stiffness, option.linear.damping) == (link.stiffness, link.damping)

    def _possible(self, names: list[str], apart: Floats) -> Iterator[State]:
        if not names:
            yield {}
            return
        first, *rest = names
        for option in self._options[first]:
            nearer = self._reach.limited(apart, self._links[first].between, option)
            if nearer is not None:
                for others in self._possible(rest, nearer):
                    yield {first: option} | others

    @cached_property
    def _verdicts(self) -> tuple[list[Shaking], int]:
        """What grows, and how many states were not judged. One that is as it is taken is judged with the whole scene;
        points that are joined in the same way in several states, once."""
        verdicts, left, unjudged = dict[object, Shaking | None](), _WORK, 0
        for state in (one for part in self.parts for one in part):
            if all(self._is_taken(name, option) for name, option in state.items()):
                continue
            left -= _OF_STATE
            is_judged = left > 0.0 and all(math.isfinite(option.linear.stiffness) for option in state.values())
            for blocks, names in self._joined(state) if is_judged else ():
                key = blocks, tuple((name, state[name].linear) for name in names if state[name].acts)
                if key in verdicts:
                    continue
                network, points = self._part(blocks, state)
                if never_grows(network):
                    verdicts[key] = None
                    continue
                left -= _work(network)
                if left < 0.0:
                    is_judged = False
                    continue
                shaking = NetworkVerdict(network, points).shaken_by_network(_snaps(network))
                how = ", ".join(f"{name} is {state[name].state}" for name in names)
                verdicts[key] = shaking and shaking._replace(state=how)
            unjudged += not is_judged
        return [one for one in verdicts.values() if one is not None], unjudged

    @cached_property
    def _block(self) -> Indices:
        """(points,): the same number for points that are joined in every state."""
        same = np.array([name not in self._options for name in self._links], dtype=bool)
        same = np.append(same, np.ones(len(self._network.ends) - same.size, bool))
        return part_of_each(self._network.ends[same & _acts(self._network)], len(self._points))

    def _joined(self, state: State) -> Iterator[tuple[frozenset[int], list[str]]]:
        """Blocks of points that the links join in this state, and the links of the state that end there."""
        of_ends = {name: [int(self._block[end]) if end >= 0 else -1 for end in self._ends[name]] for name in state}
        every = sorted({block for ends in of_ends.values() for block in ends} - {-1})
        number = {block: i for i, block in enumerate(every)} | {-1: -1}
        acting = [[number[block] for block in of_ends[name]] for name, option in state.items() if option.acts]
        part = part_of_each(np.array(acting, dtype=np.intp).reshape(-1, 2), len(every))
        for one in np.unique(part).tolist():
            blocks = frozenset(block for block, its in zip(every, part.tolist(), strict=True) if its == one)
            yield blocks, [name for name, ends in of_ends.items() if blocks & {*ends}]

    def _part(self, blocks: frozenset[int], state: State) -> tuple[Network, tuple[str, ...]]:
        """These points in this state, and their names."""
        stiffness, damping = self._network.stiffness.copy(), self._network.damping.copy()
        for i, name in enumerate(self._links):
            if name in state:
                stiffness[i], damping[i] = state[name].linear.stiffness, state[name].linear.damping
        points = np.flatnonzero(np.isin(self._block, list(blocks)))
        names = tuple(self._points[point] for point in points.tolist())
        return part_of(replace(self._network, stiffness=stiffness, damping=damping), points), names


def _acts(network: Network) -> Bools:
    """(L,): whether each link is a spring or a damper."""
    return (network.stiffness != 0.0) | (network.damping != 0.0)


def _work(network: Network) -> float:
    size = state_size(network)
    return _OF_LARGE * size if size > LARGE else (size + _OF_EACH) ** 3


def _snaps(network: Network) -> int:
    """In how many ways the points are driven on where nothing moves: as many poles are a snap's own."""
    if not (network.stiffness < 0.0).any():
        return 0
    stretches = stretches_of(network, sparse=False)
    held = np.append(network.channel_stiffness, np.zeros(network.point_mass.size))
    stiffness = np.linalg.eigvalsh(stretches.T @ (network.stiffness[:, None] * stretches) + np.diag(held))
    return int((stiffness < -1e-9 * np.abs(stiffness).max(initial=0.0)).sum())


class _Reach:
    """How far from each other the ends of a scene's contacts can be.

    Attributes:
        apart: (n, n): m, by how much the first may be further than the second from where each begins; n - 1 points
            that contacts touch, and what is fixed.
    """

    def __init__(self, scene: Scene, linear: LinearScene, contacts: Collection[str]) -> None:
        self._begins = _beginnings(scene)
        touched = {end for name in contacts for end in linear.links[name].between if end not in scene.grounds}
        self._index = {name: i for i, name in enumerate((*sorted(touched), _FIXED))}
        near: dict[str, list[tuple[str, float]]] = {}
        for first, second, least, most in self._limits(scene, linear, contacts):
            near.setdefault(second, []).append((first, most))
            near.setdefault(first, []).append((second, -least))
        ways = [_least_ways(near, name) for name in self._index]
        self.apart = np.array([[way.get(name, math.inf) for way in ways] for name in self._index])

    def _limits(
        self, scene: Scene, linear: LinearScene, contacts: Collection[str]
    ) -> Iterator[tuple[str, str, float, float]]:
        """Two points, and between which distances from where they begin to each other they stay, m."""
        for name, hand in scene.device_points.items():
            low, high = scene.device.travels(scene.channels)[hand.channel]
            begins = self._begins[name]
            yield name, _FIXED, low - begins, high - begins
        fast = {name: (abs(point.start()[1]), point.mass) for name, point in scene.material_points.items()}
        springs = [(link, self._stretch(link.between)) for name, link in linear.links.items() if name not in contacts]
        springs += [(link, self._stretch_inside(scene, linear, link.between)) for link in linear.inner]
        for link, stretch in springs:
            first, second = (_FIXED if end in linear.fixed else end for end in link.between)
            # A hand goes where it likes: what ties a mass to it says nothing of where that is.
            if link.stiffness > 0.0 and first != second and not {first, second} & scene.device_points.keys():
                speeds = (fast.get(end, (0.0, 0.0)) for end in link.between)
                swung = sum(v * math.sqrt(m / link.stiffness) for v, m in speeds)
                way = 2.0 * (scene.device.force_limit / link.stiffness + abs(stretch) + swung)
                yield first, second, -way, way

    def _stretch(self, between: tuple[str, str]) -> float:
        """m, where the scene begins."""
        first, second = between
        return self._begins[first] - self._begins[second]

    def _stretch_inside(self, scene: Scene, linear: LinearScene, between: tuple[str, str]) -> float:
        """m, of what is inside a structure, or holds a point by itself, where the scene begins."""
        if not {*between} & linear.fixed:
            return self._stretch(between)
        name = next(end for end in between if end not in linear.fixed)
        point = scene.material_points.get(name)
        held = None if point is None else point.held_by()
        rest = scene.structures[name.partition(".")[0]].position if point is None else self._begins[name]
        return self._begins[name] - (rest if held is None else held.rest)

    def met(self, between: tuple[str, str], options: tuple[Option, ...]) -> tuple[Option, ...]:
        """These without those for which the ends have to meet, or to move by more, where they cannot."""
        begins = self._stretch(between)
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        options = tuple(one for one in options if one.moved <= self.apart[i, j] + self.apart[j, i])
        meet = self.limited(self.apart, between, Option("", Linear(0.0, 0.0), -2.0 * _MEETS, 2.0 * _MEETS)) is not None
        return tuple(one for one in options if not one.through or meet or one.low <= begins <= one.high)

    def limited(self, apart: Floats, between: tuple[str, str], option: Option) -> Floats | None:
        """`apart` where this link is in such a piece; None where it cannot be."""
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        begins = self._stretch(between)
        for one, other, most in ((i, j, option.high - begins), (j, i, begins - option.low)):
            if apart[other, one] + most <= _MEETS:
                return None
            if most < apart[one, other]:
                apart = np.minimum(apart, apart[:, [one]] + most + apart[[other], :])
        return apart


def _beginnings(scene: Scene) -> dict[str, float]:
    """Where each point of the scene is when it begins, m: a hand at 0, or as near as its travel lets it."""
    found = {name: ground.position for name, ground in scene.grounds.items()}
    for name, point in scene.device_points.items():
        low, high = scene.device.travels(scene.channels)[point.channel]
        found[name] = min(max(0.0, low), high)
    found |= {name: mass.start()[0] for name, mass in scene.material_points.items()}
    for name, structure in scene.structures.items():
        places = (f"{name}.{place}" for place in structure.point_names())
        found |= dict(zip(places, structure.initial_positions(), strict=True))
    return found


def _least_ways(near: dict[str, list[tuple[str, float]]], start: str) -> dict[str, float]:
    """From `start` to every point that limits reach, the least sum of them (Dijkstra, 1959)."""
    found: dict[str, float] = {}
    waiting = [(0.0, start)]
    while waiting:
        way, name = heapq.heappop(waiting)
        if name not in found:
            found[name] = way
            for other, more in near.get(name, ()):
                if other not in found and math.isfinite(more):
                    heapq.heappush(waiting, (way + more, other))
    return found
