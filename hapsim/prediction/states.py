"""States of a scene's contacts, plectra, tables and dry friction, and the motion that grows in each.

A state lists for every such link the piece of its law that it is in. It can occur if the positions allow it: hands
within their travel, masses as far from their start as springs allow. The springs of a point let it move twice as far as
the force limit deflects them at rest, and back through a stretch at the start. Links between a ground and a hand that
moves nothing else are not included: that hand has regions (`stability.Region`).
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from functools import cached_property
from itertools import chain, combinations, islice, product
from typing import NamedTuple

import numpy as np

from hapsim.laws import Linear
from hapsim.prediction.backlash import Rattle, free_network, rattle_in
from hapsim.prediction.line_motion import lasting_swings
from hapsim.prediction.linear import LinearScene, coupling_reason, fastest_motion, needs_network
from hapsim.prediction.reach import Option, Reach, State, options_of, part_swing
from hapsim.prediction.swings import NetworkVerdict, Shaking, Swing
from hapsim.scales import SCALES
from hapsim.scene import Scene
from hapsim.theory import Network, NotWorkedOutError
from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network import LARGE, SURELY, part_of, part_of_each, parts_of, proves_stability, state_size

IN_PLAY = "is in its play"
"""State of a hand whose motor moves alone."""
MOST_STATES = 1024
"""Limit of the states in one part of the scene."""
_WORK = 4e8  # cubes of sizes of states: half a second on one core
_OF_STATE = 4e5  # cost of a state that needs no computation
_OF_EACH = 90.0  # added to the size: the part of the time that does not grow with it
_OF_LARGE = 1.6e5  # times the size of a large one
_MOST_CONTACTS = 64  # in one part
_MOST_IN_PLAY = 60  # numbers in the state of a part whose play is simulated
_LEAST_GROWTH = 1e-6  # in a sample, of a swing that is gone at once


class Grown(NamedTuple):
    """Part of the scene in which a motion grows."""

    shaking: Shaking
    """Motion that grows fastest."""
    points: list[int]
    """Numbers of its points."""
    states: list[tuple[float, State]]
    """Growth in a sample, and the state of the contacts in which it occurs."""


class ContactStates:
    """States of a scene's piecewise links; each is judged when needed.

    Attributes:
        parts: parts of the scene that no link joins: for each the states that can occur.
        is_complete: False if a part has more states than the limit.
    """

    def __init__(self, scene: Scene, linear: LinearScene, network: Network, points: tuple[str, ...]) -> None:
        """`linear`, `network`, `points`: the linear form of the scene."""
        self._scene, self._linear, self._network, self._points = scene, linear, network, points
        self._single = {name for name in scene.device_points if not coupling_reason(scene, linear, name)}
        alone = {name for name in self._single if not needs_network(scene, name)}
        self._ends = dict(zip(linear.links, network.ends.tolist(), strict=False))
        moving = (name for name, (first, second) in self._ends.items() if first != second)  # not two grounds, -1
        own = (name for name in moving if not {*linear.links[name].between} & alone)
        self._fastest, links = fastest_motion(scene), scene.links
        is_rotary = {name: scene.units_at(name).is_rotary for name in own}
        ways = {
            name: SCALES["rotary" if turns else "linear"].crossing / scene.rate for name, turns in is_rotary.items()
        }
        every = ((name, options_of(links[name].law(), self._fastest, ways[name])) for name in ways)
        options = {name: found for name, found in every if len(found) > 1}
        self._options: dict[str, tuple[Option, ...]] = {}
        self._rattles: dict[str, Rattle | None] = {}
        self.parts: list[list[State]] = []
        self.is_complete = True
        if not options:
            return
        self._reach = Reach(scene, linear, options)
        self._options = {name: self._reach.met(linear.links[name].between, found) for name, found in options.items()}
        part, names_of = parts_of(network), dict[int, list[str]]()
        for name in options:
            names_of.setdefault(int(part[max(self._ends[name])]), []).append(name)
        for names in names_of.values():
            found: list[State] = []
            if len(names) <= _MOST_CONTACTS:
                found += islice(self._possible(names, self._reach.apart), MOST_STATES + 1)
            self.is_complete &= len(names) <= _MOST_CONTACTS
            self.is_complete &= len(found) <= MOST_STATES and self._reach.tries >= 0
            self.parts.append(found[:MOST_STATES])

    @property
    def count(self) -> int:
        """Number of possible states that were found."""
        return sum(map(len, self.parts))

    @property
    def growing(self) -> list[Shaking]:
        """Motions that surely grow, one for each state that has one."""
        return [*dict.fromkeys(one for one, *_ in self._verdicts[0]), *(one.shaking for one in self._in_play)]

    def rattle_of(self, name: str) -> Rattle | None:
        """Returns the oscillation of this hand in the play of its transmission. Raises NotWorkedOutError for a part
        with contacts, other hands, substeps or implicit links, a large one, or one in which a motion grows in mesh."""
        if name not in self._rattles:
            points = self._points_with(self._points.index(name))
            names, network = tuple(self._points[i] for i in points), part_of(self._network, np.array(points))
            is_one = network.channel_mass.size == 1 and network.substeps == 1 and not network.implicit.any()
            has_contacts = any({*self._linear.links[at].between} & {*names} for at in self._options)
            if has_contacts or not is_one or state_size(network) > _MOST_IN_PLAY:
                raise NotWorkedOutError("the play is simulated for one hand with linear links, in a small part")
            if NetworkVerdict(network, names).may_grow():
                raise NotWorkedOutError("a motion grows in mesh")
            channel = self._scene.device_points[name].channel
            self._rattles[name] = rattle_in(network, self._scene.device.drives(self._scene.channels)[channel].backlash)
        return self._rattles[name]

    @cached_property
    def _in_play(self) -> list[Grown]:
        """Motions that grow while a motor moves alone, in the play of its transmission."""
        found = []
        for free, names, number in self._free_motors(self._network):
            name = self._points[number]
            if shaking := NetworkVerdict(free, names).shaken_by_network():
                swing, count = None, self._scene.mock_device.quantum[self._scene.device_points[name].channel]
                with contextlib.suppress(NotWorkedOutError):
                    if rattle := self.rattle_of(name):
                        swing = Swing(name, rattle.motor, rattle.motor, 0.0, 0.0, rattle.motor < count)
                points = self._points_with(number)
                found.append(Grown(shaking._replace(state=f"{name} {IN_PLAY}", swing=swing), points, []))
        return found

    def _free_motors(self, network: Network) -> Iterator[tuple[Network, tuple[str, ...], int]]:
        """Yields each part of a network of these links with a motor alone, in its play: its network, the names of its
        points, and the number of the hand."""
        drives = self._scene.device.drives(self._scene.channels)
        for number, point in enumerate(self._scene.device_points.values()):
            free = free_network(network, number) if drives[point.channel].backlash > 0.0 else None
            if free is not None:
                points = self._points_with(number)
                yield part_of(free, np.array(points)), tuple(self._points[one] for one in points), number

    def _points_with(self, number: int) -> list[int]:
        """Returns the numbers of the points that links join to this one, itself among them."""
        part = parts_of(self._network)
        return np.flatnonzero(part == part[number]).tolist()

    @property
    def unjudged(self) -> int:
        """Number of states that were found but not judged, for lack of time; at least 1 if more states can occur."""
        return max(self._verdicts[1], int(not self.is_complete))

    @property
    def words(self) -> str:
        """Phrase that follows "stable" or "unstable" and limits the verdict; "" if there is one state."""
        if self.growing:
            return f"while {max(self.growing, key=lambda one: one.rank).state}"
        if self.unjudged:
            return "with its contacts as assumed; not every state of them was judged"
        return f"in all {self.count} states of its contacts; bounces are not judged" if self.count > 1 else ""

    def instead(self, is_free: bool) -> dict[str, Linear]:
        """Links whose assumed state is impossible after those of the links before them, with their possible states. If
        the hands are `is_free`, nothing rests in a snap either: then the nearest other piece is taken."""
        found: dict[str, Linear] = {}
        for names in (part[0] for part in self.parts if part):
            apart = self._reach.apart
            for name in names:
                options, between = self._options[name], self._linear.links[name].between
                taken = [one for one in options if self._is_assumed(name, one)]
                why = f"it cannot be {taken[0].state} with the links before it as assumed" if taken else ""
                if is_free and self._linear.links[name].stiffness < 0.0:
                    taken, why = [], "nothing rests where its force falls"
                    options = tuple(sorted(options, key=lambda one: (one.linear.stiffness < 0.0, one.away)))
                every = (self._reach.possible(apart, between, one) for one in (*taken, *options) if why)
                one, apart = next(chain.from_iterable(every), (None, apart))
                if one is not None and not self._is_assumed(name, one):
                    found[name] = one.linear._replace(assumption=f"is taken as {one.state}: {why}")
        return found

    def _is_assumed(self, name: str, option: Option) -> bool:
        link = self._linear.links[name]
        return (option.linear.stiffness, option.linear.damping) == (link.stiffness, link.damping)

    def _possible(self, names: list[str], apart: Floats) -> Iterator[State]:
        """Yields the states that these links can be in together, each once: a piece that repeats in one of its copies
        that permit it."""
        if not names:
            yield {}
            return
        first, *rest = names
        most = math.prod(len({one.kind for one in self._options[name]}) for name in rest)
        found = dict[object, set[object]]()
        for option in self._options[first]:
            beside = found.setdefault(option.kind, set())
            for copy, nearer in self._reach.possible(apart, self._linear.links[first].between, option):
                if len(beside) == most:
                    break
                for others in self._possible(rest, nearer):
                    kinds = tuple(one.kind for one in others.values())
                    if kinds not in beside:
                        beside.add(kinds)
                        yield {first: copy} | others

    @cached_property
    def _verdicts(self) -> tuple[list[tuple[Shaking, State, frozenset[int]]], int]:
        """Growing motions with their states and blocks, and the number of states that were not judged. The assumed
        state is judged with the whole scene; points that several states join in the same way are judged once."""
        verdicts, left, unjudged = dict[object, Shaking | None](), _WORK, 0
        found: list[tuple[Shaking, State, frozenset[int]]] = []
        for state in (swept for part in self.parts for swept in self._with_swept(part)):
            held = all(option.linear.stiffness >= 0.0 for option in state.values())
            if held and all(self._is_assumed(name, option) for name, option in state.items()):
                continue
            left -= _OF_STATE
            is_judged = left > 0.0 and all(math.isfinite(option.linear.stiffness) for option in state.values())
            for blocks, names in self._joined(state) if is_judged else ():
                sweep = max((state[name].sweep for name in names), default=0.0)
                key = blocks, sweep, tuple((name, state[name].linear) for name in names if state[name].acts)
                if key not in verdicts:
                    most_angle = self._most_angle(sweep)
                    network, points = self._part(blocks, state)
                    grows, size = not proves_stability(network), state_size(network)
                    left -= grows * (_OF_LARGE * size if size > LARGE else (size + _OF_EACH) ** 3)
                    if left < 0.0:
                        is_judged = False
                        continue
                    shaking = NetworkVerdict(network, points).shaken_by_network(most_angle) if grows else None
                    if shaking and shaking.snaps and not self._swing_growth(blocks, state, names) > SURELY:
                        shaking = None
                    how = ", ".join(f"{name} is {state[name].state}" for name in names)
                    verdicts[key] = shaking and shaking._replace(state=how)
                if (grown := verdicts[key]) is not None:
                    found.append((grown, state, blocks))
            unjudged += not is_judged
        return found, unjudged

    def _swing_growth(self, blocks: frozenset[int], state: State, names: list[str]) -> float:
        """Factor by which a swing across the periods of the links that fall in this state grows in a sample: the mean
        over their pieces, by widths. Infinity if none repeats."""
        falls = [name for name in names if state[name].period and state[name].linear.stiffness < 0.0]
        mean = 0.0 if falls else math.inf
        for pieces in product(*(self._options[name] for name in falls)) if falls else ():
            share = math.prod((one.high - one.low) / one.period for one in pieces)
            network, points = self._part(blocks, state | dict(zip(falls, pieces, strict=True)))
            mean += share * math.log(max(NetworkVerdict(network, points).swing_growth, _LEAST_GROWTH))
        return math.exp(mean)

    def _with_swept(self, states: list[State]) -> Iterator[State]:
        """Yields these states, then others in which links that repeat are swept across, each once."""
        yield from states
        seen = set[object]()
        for state in states:
            swept = {name: one.swept for name, one in state.items() if one.period and self._is_swept(name, one.period)}
            for names in chain.from_iterable(combinations(swept, count + 1) for count in range(len(swept))):
                other = state | {name: swept[name] for name in names}
                if (kinds := tuple(one.kind for one in other.values())) not in seen:
                    seen.add(kinds)
                    yield other

    def _is_swept(self, name: str, period: float) -> bool:
        """Returns whether a swing takes this link across its period: not that of a hand that moves nothing else, which
        is softer there than in its notches."""
        between = self._linear.links[name].between
        return not {*between} & self._single and self._reach.way(between) >= period

    def grown(self, is_unstable: bool, regional: Collection[str]) -> list[Grown]:
        """Returns the fastest growing motion of each part of the scene that has one, the fastest first. `is_unstable`:
        a motion grows in the assumed state too, apart from hands that are `regional`."""
        of_point = parts_of(self._network).tolist()
        points = {its: [i for i, at in enumerate(of_point) if at == its] for its in dict.fromkeys(of_point)}
        part = {name: of_point[max(self._ends[name])] for one in self.parts for state in one for name in state}
        grown = dict[int, list[tuple[Shaking, State]]]()
        for shaking, state, _ in self._verdicts[0]:
            grown.setdefault(part[next(iter(state))], []).append((shaking, state))
        for its, inside in points.items() if is_unstable else ():
            names = tuple(self._points[point] for point in inside)
            taken = NetworkVerdict(part_of(self._network, np.array(inside)), names).shaken_by_network()
            is_judged = taken is not None and taken.snaps and its in part.values()  # as one of its states
            if taken is not None and not is_judged and not {*names} & {*regional}:
                options = {name: [one for one in self._options[name] if self._is_assumed(name, one)] for name in part}
                state = {name: found[0] for name, found in options.items() if part[name] == its and found}
                grown.setdefault(its, []).append((taken, state))
        most = {its: max((one for one, _ in every), key=lambda one: one.rank) for its, every in grown.items()}
        states = {its: [(one.growth, state) for one, state in every] for its, every in grown.items()}
        found = [*(Grown(most[its], points[its], states[its]) for its in most), *self._in_play]
        return sorted(found, key=lambda one: one.shaking.rank, reverse=True)

    def grows_with(self, network: Network, times: Mapping[str, tuple[float, float]]) -> bool:
        """Returns whether a motion grows in one of the states in which one does today, with another network of the same
        links, and some of them with other stiffnesses and dampings, as factors; the fastest is tried first."""
        for _, state, blocks in sorted(self._verdicts[0], key=lambda one: -one[0].growth):
            other = {
                name: one._replace(
                    linear=one.linear._replace(stiffness=one.linear.stiffness * k, damping=one.linear.damping * b)
                )
                for name, one in state.items()
                for k, b in [times.get(name, (1.0, 1.0))]
            }
            sweep = max((one.sweep for one in state.values()), default=0.0)
            if NetworkVerdict(*self._part(blocks, other, network)).may_grow(self._most_angle(sweep)):
                return True
        return any(NetworkVerdict(free, names).may_grow() for free, names, _ in self._free_motors(network))

    def _most_angle(self, sweep: float) -> float:
        """Turn of a motion in a sample, rad, above which a hand cannot swing so far, m."""
        return 2.0 * self._fastest / (sweep * self._network.rate) if sweep else math.inf

    def swing_of(self, grown: Grown) -> Swing | None:
        """Returns the size of the oscillation in this part of the scene; None if it was not found."""
        if grown.shaking.swing is not None:
            return grown.shaking.swing
        return part_swing(self._scene, self._linear, self._network, self._points, grown.points, grown.states)

    def lasting_swings(self, poles: Complexes) -> dict[str, Swing]:
        """Returns the largest swings that go on after a knock, of each part of the scene on a board with lines, by the
        point that moves most. `poles`: of the assumed state."""
        return lasting_swings(self._scene, self._linear, self._network, self._points, poles)

    @cached_property
    def _block(self) -> Indices:
        """Block number of each point, (points,): equal for points that are joined in every state."""
        same = np.array([name not in self._options for name in self._linear.links], dtype=bool)
        same = np.append(same, np.ones(self._network.stiffness.size - same.size, bool))
        acts = (self._network.stiffness != 0.0) | (self._network.damping != 0.0)
        return parts_of(self._network, same & acts)

    def _joined(self, state: State) -> Iterator[tuple[frozenset[int], list[str]]]:
        """Yields blocks of points that the links join in this state, and the links of the state that end there."""
        of_ends = {name: [int(self._block[end]) if end >= 0 else -1 for end in self._ends[name]] for name in state}
        every = sorted({block for ends in of_ends.values() for block in ends} - {-1})
        number = {block: i for i, block in enumerate(every)} | {-1: -1}
        acting = [[number[block] for block in of_ends[name]] for name, option in state.items() if option.acts]
        part = part_of_each(np.array(acting, dtype=np.intp).reshape(-1, 2), len(every))
        for one in np.unique(part).tolist():
            blocks = frozenset(block for block, its in zip(every, part.tolist(), strict=True) if its == one)
            yield blocks, [name for name, ends in of_ends.items() if blocks & {*ends}]

    def _part(
        self, blocks: frozenset[int], state: State, network: Network | None = None
    ) -> tuple[Network, tuple[str, ...]]:
        """Returns the network of these points in this state, and their names."""
        network = network or self._network
        stiffness, damping = network.stiffness.copy(), network.damping.copy()
        for i, name in enumerate(self._linear.links):
            if name in state:
                stiffness[i], damping[i] = state[name].linear.stiffness, state[name].linear.damping
        points = np.flatnonzero(np.isin(self._block, list(blocks)))
        names = tuple(self._points[point] for point in points.tolist())
        return part_of(replace(network, stiffness=stiffness, damping=damping), points), names
