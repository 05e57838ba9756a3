"""Pieces of their laws that a scene's links can be in, distances that its points can have, and rests of a hand and its
masses under a steady push in a state of their contacts."""

from __future__ import annotations

import heapq
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hapsim.errors import UsageError
from hapsim.laws import Law, Linear
from hapsim.prediction.linear import STAYS, LinearScene, linear_scene, network_of, spread
from hapsim.prediction.swings import Rest, Swing, Swinging, has_pieces
from hapsim.scene import Scene
from hapsim.theory import Network
from hapsim.theory.arrays import Floats
from hapsim.theory.network import part_of
from hapsim.theory.rows import Rows, stretches_of

_MOST_STEPS = 100
_AT_REST = 1e-12  # m: movement of a mass in the last step
_HALVINGS = 30
_LEAST_STIFFNESS = 1e-9  # of the stiffest link, for a mass that no spring holds


class Option(NamedTuple):
    """Piece of a link's law, with its spring and damper, between two distances, m."""

    state: str
    linear: Linear
    low: float = -math.inf
    high: float = math.inf
    through: bool = False
    """True if its ends have to meet before."""
    moved: float = 0.0
    """Movement of its ends that it needs before, m."""
    period: float = 0.0
    """Period of the piece, m; 0: none."""
    sweep: float = 0.0
    """Swing of its ends from end to end, m, for which the piece stands: a period; 0: a small one."""

    @property
    def kind(self) -> tuple[object, ...]:
        """Key of alike pieces of its law; copies and alike pieces of a law that repeats have one."""
        return self.state, self.linear, None if self.period else self.low

    @property
    def away(self) -> float:
        """Least distance of its ends from 0, m."""
        return max(self.low, -self.high, 0.0)

    @property
    def swept(self) -> Option:
        """The mean of a piece that repeats, for a swing across its period: no spring."""
        linear = self.linear._replace(stiffness=0.0)
        return Option("swept across its period", linear, sweep=self.period)

    @property
    def acts(self) -> bool:
        """True if it is a spring or a damper at all."""
        return self.linear.stiffness != 0.0 or self.linear.damping != 0.0


def options_of(law: Law, fastest: float = 1.0, way: float = 0.0) -> tuple[Option, ...]:
    """Returns the pieces that a link of this law can be in, with equal neighbours joined; one for a linear link.
    `fastest`: largest speed of its ends, m/s. `way`: m, over which a fall is spread that is narrower."""
    here = law.linear()
    if law.variants:
        return tuple(option for one in law.variants.values() for option in options_of(one, fastest))
    pieces = [(piece, here._replace(stiffness=piece.slope, damping=piece.damping)) for piece in law.pieces]
    if law.is_dry:
        return Option("stuck", here), Option("sliding", here._replace(stiffness=0.0, damping=0.0), moved=law.reach)
    if law.grips:
        (_, gripping, _), edge = pieces, law.edges[-1]
        free = here._replace(stiffness=0.0, damping=0.0)
        return Option("gripping", gripping[1], -edge, edge, through=True), Option("released", free)
    ends = [(piece.edge, after.edge) for (piece, _), (after, _) in pairwise(pieces)]
    ends.append((pieces[-1][0].edge, pieces[0][0].edge + law.period if law.period else math.inf))
    found: list[Option] = []
    for (piece, linear), (low, high) in zip(pieces, ends, strict=True):
        if found and (found[-1].linear, found[-1].state) == (linear, piece.state):
            found[-1] = found[-1]._replace(high=high)
        else:
            found.append(Option(piece.state, linear, low, high, period=law.period))
    found = [
        one._replace(linear=spread(one.linear, (one.high - one.low) / way)) if one.high - one.low < way else one
        for one in found
    ]
    dampings = law.dampings_at(fastest)
    if not dampings:
        return tuple(found)
    paced = []
    weak = "faster than its table" if min(-law.speeds[0][0], law.speeds[-1][0]) < fastest else "at its weakest"
    for pace, damping in [("slow", None), *(("fast" if one > here.damping else weak, one) for one in dampings)]:
        for one in found:
            linear = one.linear if damping is None else one.linear._replace(damping=damping)
            paced.append(one._replace(state=f"{one.state} and {pace}" if one.state else pace, linear=linear))
    return tuple(paced)


State = dict[str, Option]
"""Piece of each link of a part of the scene, by name."""


_MOST_COPIES = 32  # of a piece that repeats, to either side of the start
_MOST_TRIES = 100_000  # half a second
_OVERLAP = 1e-12  # m: smaller overlaps do not count


class Reach:
    """Ranges of the distances between the ends of a scene's contacts.

    Attributes:
        apart: (n, n), m: limit of the first point's position minus the second's, relative to the start; n - 1 points
            that contacts touch, and the fixed place.
    """

    def __init__(self, scene: Scene, linear: LinearScene, contacts: Collection[str]) -> None:
        self._begins, self.tries = start_positions(scene), _MOST_TRIES
        touched = {end for name in contacts for end in linear.links[name].between if end not in scene.grounds}
        self._index = {name: i for i, name in enumerate((*sorted(touched), STAYS))}
        near: dict[str, list[tuple[str, float]]] = {}
        for first, second, least, most in self._limits(scene, linear, contacts):
            near.setdefault(second, []).append((first, most))
            near.setdefault(first, []).append((second, -least))
        ways = [_shortest_sums(near, name) for name in self._index]
        self.apart = np.array([[way.get(name, math.inf) for way in ways] for name in self._index])

    def _limits(
        self, scene: Scene, linear: LinearScene, contacts: Collection[str]
    ) -> Iterator[tuple[str, str, float, float]]:
        """Yields two points, and the least and most change of their distance from the start, m."""
        hands = scene.device_points
        for name, hand in hands.items():
            low, high = scene.device.travels(scene.channels)[hand.channel]
            begins = self._begins[name]
            yield name, STAYS, low - begins, high - begins
        fast = {name: (abs(point.start()[1]), point.mass) for name, point in scene.material_points.items()}
        named = [*linear.links.items(), *(("", link) for link in linear.inner)]
        for (name, link), stretch in zip(named, start_stretches(scene, linear), strict=True):
            if name in contacts:
                continue
            first, second = (STAYS if end in linear.fixed else end for end in link.between)
            # A hand moves freely, so a spring to it does not limit the position of a mass.
            if link.stiffness > 0.0 and first != second and not {first, second} & hands.keys():
                speeds = (fast.get(end, (0.0, 0.0)) for end in link.between)
                swung = sum(v * math.sqrt(m / link.stiffness) for v, m in speeds)
                way = 2.0 * (scene.device.force_limit / link.stiffness + abs(stretch) + swung)
                yield first, second, -way, way

    def met(self, between: tuple[str, str], options: tuple[Option, ...]) -> tuple[Option, ...]:
        """Returns these options without those that need ends to meet, or to move by more, which they cannot."""
        begins = self._begins[between[0]] - self._begins[between[1]]
        options = tuple(one for one in options if one.moved <= self.way(between))
        touching = Option("", Linear(0.0, 0.0), -2.0 * _OVERLAP, 2.0 * _OVERLAP)
        meet = self.limited(self.apart, between, touching) is not None
        return tuple(one for one in options if not one.through or meet or one.low <= begins <= one.high)

    def way(self, between: tuple[str, str]) -> float:
        """Returns how far the ends of this link can move, m, from the least distance to the largest."""
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        return float(self.apart[i, j] + self.apart[j, i])

    def possible(self, apart: Floats, between: tuple[str, str], option: Option) -> Iterator[tuple[Option, Floats]]:
        """Yields the copies of a piece that this link can be in, the nearest to its start first, each with `apart`
        then. A piece that does not repeat is its only copy."""
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        begins, away = self._begins[between[0]] - self._begins[between[1]], [0.0]
        if period := option.period:
            least, most = (min(apart[way], _MOST_COPIES * period) for way in ((j, i), (i, j)))
            first = math.floor((begins - least - option.high) / period)
            last = math.ceil((begins + most - option.low) / period)
            middle = begins - 0.5 * (option.low + option.high)
            away = sorted((n * period for n in range(first, last + 1)), key=lambda x: abs(x - middle))
        for x in away:
            self.tries -= bool(period)
            if self.tries < 0:
                return
            copy = option._replace(low=option.low + x, high=option.high + x)
            if (nearer := self.limited(apart, between, copy)) is not None:
                yield copy, nearer

    def limited(self, apart: Floats, between: tuple[str, str], option: Option) -> Floats | None:
        """Returns `apart` with this link in such a piece; None if it cannot be in it."""
        i, j = (self._index.get(end, len(self._index) - 1) for end in between)
        begins = self._begins[between[0]] - self._begins[between[1]]
        for one, other, most in ((i, j, option.high - begins), (j, i, begins - option.low)):
            if apart[other, one] + most <= _OVERLAP:
                return None
            if most < apart[one, other]:
                apart = np.minimum(apart, apart[:, [one]] + most + apart[[other], :])
        return apart


def start_stretches(scene: Scene, linear: LinearScene) -> Floats:
    """Initial stretches (L,), m, of the scene's links and of the elements of its structures and material points."""
    begins, found = start_positions(scene), []
    for link in (*linear.links.values(), *linear.inner):
        first, second = ("" if end == STAYS else end for end in link.between)
        name = first or second
        if first and second:
            found.append(begins[first] - begins[second])
        elif (point := scene.material_points.get(name)) is None:
            found.append((begins[name] - scene.structures[name.partition(".")[0]].position) * (1.0 if first else -1.0))
        else:
            held = point.held_by()
            found.append(0.0 if held is None else begins[name] - held.rest)
    return np.array(found)


def start_positions(scene: Scene) -> dict[str, float]:
    """Positions of all points at the start, m: a hand at 0, or as near as its travel permits."""
    found = {name: ground.position for name, ground in scene.grounds.items()}
    for name, point in scene.device_points.items():
        low, high = scene.device.travels(scene.channels)[point.channel]
        found[name] = min(max(0.0, low), high)
    found |= {name: mass.start()[0] for name, mass in scene.material_points.items()}
    for name, structure in scene.structures.items():
        places = (f"{name}.{place}" for place in structure.point_names())
        found |= dict(zip(places, structure.initial_positions(), strict=True))
    return found


def _shortest_sums(near: dict[str, list[tuple[str, float]]], start: str) -> dict[str, float]:
    """Least sum of limits from `start` to every point that they reach (Dijkstra, 1959)."""
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


_INSIDE = 1e-2  # m: distance of a hand from the only edge of a state, if its press is within the limit there
_STILL = 1e-12  # of the hand's movement: smaller stretches of a link count as none


def part_swing(
    scene: Scene,
    linear: LinearScene,
    network: Network,
    points: Sequence[str],
    inside: Sequence[int],
    grown: Sequence[tuple[float, State]],
) -> Swing | None:
    """Returns the oscillation in a part of the scene, from its rests in states in which a motion grows.

    Args:
        inside: the numbers of the part's points, ascending, which no link joins to another.
        grown: growth in a sample, and the state.

    Returns:
        None also if the part has several hands, masses that pull themselves, or links with a memory. It is never
        unnoticed if a motion grows in a state that has no rest, or while a damper is fast, or beside a detent.
    """
    names = [points[point] for point in inside]
    hands = [name for name in names if name in scene.device_points]
    if not names or pulls_itself(scene, names):
        return None
    part, links, laws, fixed = part_with_laws(scene, linear, network, points, inside)
    channel = scene.device_points[hands[0]].channel if hands else 0
    travel, quantum = scene.device.travels(scene.channels)[channel], scene.mock_device.quantum[channel]
    swinging = Swinging(part, names, laws, scene.device.force_limit, travel, quantum)
    if not laws or not swinging.is_simulated:
        return None
    rests = []
    for growth, state in grown:
        springs = part.stiffness.copy(), part.damping.copy()
        pieces = dict.fromkeys(laws, (-math.inf, math.inf))
        for i, name in links.items():
            if name in state:
                springs[0][i], springs[1][i] = state[name].linear.stiffness, state[name].linear.damping
                pieces[i] = state[name].low, state[name].high
        there = replace(part, stiffness=springs[0], damping=springs[1])
        is_moving = any(law.speeds and springs[1][i] != law.linear().damping for i, law in laws.items())
        rests.append(
            None if is_moving else rest_in(there, fixed, laws, pieces, travel, scene.device.force_limit, growth)
        )
    found = [one for one in rests if one is not None]
    # A law that repeats has other rests, in other periods.
    is_all = len(found) == len(rests) and not any(law.period for law in laws.values())
    return swinging.swing_at(found, is_all)


def pulls_itself(scene: Scene, names: Collection[str]) -> bool:
    """Returns whether one of these points is a mass that pulls itself."""
    return any(one.pulls_itself for name, one in scene.material_points.items() if name in names)


def part_with_laws(
    scene: Scene, linear: LinearScene, network: Network, points: Sequence[str], inside: Sequence[int]
) -> tuple[Network, dict[int, str], dict[int, Law], Floats]:
    """Returns the network of a part of the scene, the names of its links by their numbers there, the laws of those with
    several pieces, and the distance of the ends of each link with all points at 0, (L,), m. `inside`: as above."""
    begins = start_positions(scene)
    numbers = np.flatnonzero(np.isin(network.ends, inside).any(axis=1)).tolist()
    part, of_link = part_of(network, np.array(inside)), [*linear.links, *("" for _ in linear.inner)]
    links = {i: of_link[link] for i, link in enumerate(numbers) if of_link[link]}
    laws = {i: law for i, name in links.items() if has_pieces(law := scene.links[name].law())}
    start = np.array([begins[points[point]] for point in inside])
    fixed = start_stretches(scene, linear)[numbers] - stretches_of(part, sparse=False) @ start
    return part, links, laws, fixed


def rest_in(
    network: Network,
    fixed: Floats,
    laws: Mapping[int, Law],
    pieces: Mapping[int, tuple[float, float]],
    travel: tuple[float, float],
    force_limit: float,
    growth: float,
) -> Rest | None:
    """Returns the rest, in the middle of this state, of a part of the scene with one hand or none, pressed no harder
    than the force limit; None if there is none.

    Args:
        network: the part, with its links in this state.
        fixed: (L,) m, part of fixed ends in each link's distance.
        laws, pieces: of the links that have several pieces, by number; ends of this piece, m.
        travel: of the hand, m. growth: in the state, of a sample.
    """
    stretches, hands, stiffness = stretches_of(network, sparse=False), network.channel_mass.size, network.stiffness
    force = stiffness * fixed
    for link, law in laws.items():
        low, high = pieces[link]
        middle = 0.5 * (low + high) if math.isfinite(high - low) else low if math.isfinite(low) else high
        middle = middle if math.isfinite(middle) else 0.0
        force[link] = float(law.tension(middle)) + stiffness[link] * (fixed[link] - middle)
    # The rest of the masses with the hand at 0, and its linear change with the hand.
    of_masses, of_hand = stretches[:, hands:], stretches[:, :hands].sum(axis=1)
    wanted = np.array([-of_masses.T @ force, -of_masses.T @ (stiffness * of_hand)]).T
    try:
        masses = np.linalg.solve(of_masses.T @ (stiffness[:, None] * of_masses), wanted)
    except np.linalg.LinAlgError:
        return None
    begin, slope = of_masses @ masses[:, 0] + fixed, of_masses @ masses[:, 1] + of_hand
    low, high = travel if hands else (0.0, 0.0)
    for link, ends in pieces.items():
        if abs(slope[link]) > _STILL:
            near, far = sorted((end - begin[link]) / slope[link] for end in ends)
            low, high = max(low, near), min(high, far)
        elif not ends[0] <= begin[link] <= ends[1]:
            return None
    press, rise = (-float(of_hand @ one) for one in (force + stiffness * (begin - fixed), stiffness * slope))
    low, high = pressed_within(low, high, press, rise, force_limit)
    if not low <= high:
        return None
    x = low + _INSIDE if math.isfinite(low) else high - _INSIDE if math.isfinite(high) else 0.0
    x = 0.5 * (low + high) if math.isfinite(high - low) else x
    distances = [float(begin[link] + slope[link] * x) for link in laws]
    return Rest(x, distances, press + rise * x, min(far - near for near, far in pieces.values()), growth)


def pressed_within(low: float, high: float, press: float, rise: float, most: float) -> tuple[float, float]:
    """Returns the part of a range, m, where the force press + rise x is at most `most`, N; empty if there is none."""
    if not rise:
        return (low, high) if abs(press) <= most else (math.inf, -math.inf)
    near, far = sorted((side * most - press) / rise for side in (-1.0, 1.0))
    return max(low, near), min(high, far)


class _Springs(NamedTuple):
    """Links (L,): those with `laws` first, then those inside structures, which are linear."""

    joins: Rows
    """Incidence (L, N): 1 at a link's first end, -1 at its second, for masses."""
    fixed: Floats
    """Part of fixed ends in its distance, (L,), m."""
    stiffness: Floats
    """Stiffnesses of the linear ones, N/m."""
    laws: list[Law]

    def distances(self, x: Floats) -> Floats:
        """Distances (L,), m, with the masses at x."""
        return np.asarray(self.joins @ x + self.fixed)

    def forces(self, x: Floats) -> Floats:
        """Force on each mass, (N,), N."""
        d, laws = self.distances(x), len(self.laws)
        of_laws = [float(law.tension(one)) for law, one in zip(self.laws, d[:laws], strict=True)]
        return np.asarray(-(self.joins.T @ np.append(of_laws, self.stiffness * d[laws:])))

    def stiffness_matrix(self, x: Floats) -> Rows:
        """Stiffness matrix (N, N), N/m; 0 for a link whose tension falls."""
        from scipy.sparse import csc_matrix, diags, identity

        of_laws = [law.slope(float(one)) for law, one in zip(self.laws, self.distances(x), strict=False)]
        slopes = np.maximum(np.append(of_laws, self.stiffness), 0.0)
        least = _LEAST_STIFFNESS * max(float(slopes.max()), 1.0)
        return csc_matrix(self.joins.T @ diags(slopes) @ self.joins + least * identity(x.size))


def links_at_rest(scene: Scene, hands: Mapping[str, float]) -> dict[str, Linear]:
    """Spring and damper of each link of the scene, by name, at `distances_at_rest`."""
    found = {}
    for name, d in distances_at_rest(scene, hands).items():
        law = scene.links[name].law()
        taken = f"is taken as {law.state(d)}: its state where the masses rest" if law.assumption else ""
        found[name] = law.linear(d)._replace(assumption=taken)
    return found


def distances_at_rest(scene: Scene, hands: Mapping[str, float]) -> dict[str, float]:
    """Distance of the ends of each link of the scene, m, by name, while the hands hold still at these positions (m) and
    the masses rest. A stuck link has no force there. UsageError if no rest is found."""
    linear, begins, first = linear_scene(scene), start_positions(scene), len(scene.device_points)
    network, points = network_of(scene, linear)
    stretches, start = stretches_of(network, sparse=True), np.array([begins[name] for name in points])
    held = start.copy()
    held[:first] = [hands.get(name, 0.0) for name in points[:first]]
    fixed = start_stretches(scene, linear) + stretches[:, :first] @ held[:first] - stretches @ start
    laws = [scene.links[name].law() for name in linear.links]
    springs = _Springs(stretches[:, first:], fixed, network.stiffness[len(laws) :], laws)
    d = springs.distances(_rest_positions(springs, start[first:]))
    return dict(zip(linear.links, d.tolist(), strict=False))


def _rest_positions(springs: _Springs, x: Floats) -> Floats:
    """Returns the rest of the masses, (N,), m, by Newton's steps, each halved until the forces are less."""
    from scipy.sparse.linalg import spsolve

    if not x.size:
        return x
    forces = springs.forces(x)
    for _ in range(_MOST_STEPS):
        step = np.atleast_1d(spsolve(springs.stiffness_matrix(x), forces))
        if float(np.max(np.abs(step))) <= _AT_REST:
            return x
        for _ in range(_HALVINGS):
            nearer = springs.forces(x + step)
            if float(np.abs(nearer).max()) < float(np.abs(forces).max()):
                break
            step = 0.5 * step
        x, forces = x + step, springs.forces(x + step)
    raise UsageError("at: no rest of the scene's masses was found for a hand held at this position")
