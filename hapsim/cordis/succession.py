"""The state that a program takes over from the one before it, between two samples of a running loop.

Modules with the same name and type in both scenes continue: points with positions and velocities, live parameters from
their current values, and links with their memory. New modules begin as in their scene, at the present hands. A
structure continues if it has as many masses as before. A material point may become one of another type, such as a mass
a cell. What a trial restarts begins as if it were new.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling.native import NativeFunction, value_of
from hapsim.cordis.dispatch import Column, action
from hapsim.cordis.parameters import GateNumbers, apply_gates
from hapsim.cordis.program import Program
from hapsim.scene import Ground, Scene
from hapsim.scene.modules import MaterialPoint, Structure


class CarriedPoints(NamedTuple):
    """Points of an older program, PROGRAM, by number there, `taken`, and here, `placed`. `rows`: its (2, N) m."""

    older: Any
    rows: Column
    taken: NDArray[np.uint32]
    placed: NDArray[np.uint32]


class CarriedNumbers(NamedTuple):
    """Numbers of an older program: source[taken] become target[placed]."""

    source: Column
    taken: NDArray[np.uint32]
    target: Column
    placed: NDArray[np.uint32]


@action
def carry_points(points, state):
    """Copies the positions of both samples of every common point."""
    points, state = value_of(points), value_of(state)
    turn = points.older.turn
    here, before = points.rows[turn], points.rows[1 - turn]
    for i in range(np.uint64(points.taken.size)):
        state.position[points.placed[i]] = here[points.taken[i]]
        state.previous[points.placed[i]] = before[points.taken[i]]


@action
def carry_numbers(numbers, _state):
    """Copies the numbers to their new places."""
    numbers = value_of(numbers)
    for i in range(np.uint64(numbers.taken.size)):
        numbers.target[numbers.placed[i]] = numbers.source[numbers.taken[i]]


def take_over_from(
    older: Program, older_scene: Scene, program: Program, scene: Scene, restart: Collection[str] = ()
) -> None:
    """Prepares `program` of `scene` to follow `older`: fills the lists that `hapsim.cordis.tick.take_over` calls.
    `restart`: names of modules whose state begins anew; their live parameters continue."""
    points = {name for name in _common_points(older_scene, scene) if name.partition(".")[0] not in restart}
    same_type = {
        name
        for name in older_scene.modules.keys() & scene.modules.keys()
        if type(older_scene.modules[name]) is type(scene.modules[name])
    }
    ramped = {name for name in same_type if scene.modules[name].live}  # a table that crossfades does not continue
    before, after = _ends(older_scene), _ends(scene)
    earlier, later = _chains(older_scene), _chains(scene)
    links = {
        name
        for name in same_type
        if name not in restart
        and before[name] == after[name]
        and points.issuperset(after[name])
        and earlier.get(name) == later.get(name)
    }
    older.call_all_of("place")
    here, there = _by_hand(scene, program.numbers), _by_hand(older_scene, older.numbers)
    taken, placed = _in_order(there, here, points)
    program.call("carry_points", [(carry_points, CarriedPoints(older.record, older.rows, taken, placed))])
    program.call(
        "carry_numbers",
        [
            *_live(older, program, ramped | {*scene.sound}),
            *_gates(older, program),
            *_remembered(older, program, links),
        ],
    )
    program.call_all_of("place")
    program.call_all_of("resume")


def _hands(scene: Scene) -> dict[str, str]:
    """Returns a common name for each hand: its channel identifies it, whatever its name in the scene."""
    return {name: f"channel {hand.channel}" for name, hand in scene.device_points.items()}


def _by_hand(scene: Scene, numbers: Mapping[str, int]) -> dict[str, int]:
    """Returns the number of each point by its name, of a hand by that of `_hands`."""
    hands = _hands(scene)
    return {hands.get(name, name): number for name, number in numbers.items()}


def _ends(scene: Scene) -> dict[str, list[str]]:
    """Returns the points at the ends of each link, by the names of `_hands`; for any other module itself."""
    hands = _hands(scene)
    own = {name: [name] for name in scene.modules}
    links = scene.links | scene.plane_links
    ends = {name: [at for end in link.between for at in scene.coordinates_of(end)] for name, link in links.items()}
    return own | {name: [hands.get(end, end) for end in both] for name, both in ends.items()}


def _chains(scene: Scene) -> dict[str, Any]:
    """Returns the line that each link follows, if any: the memory of one does not fit another."""
    return {name: link.chain() for name, link in scene.plane_links.items()}


def _common_points(older: Scene, scene: Scene) -> set[str]:
    """Returns the common points of both scenes, by the names of `_hands`."""
    same = {*_hands(older).values()} & {*_hands(scene).values()}
    for name in older.modules.keys() & scene.modules.keys():
        before, after = older.modules[name], scene.modules[name]
        if (
            isinstance(before, Structure)
            and type(before) is type(after)
            and before.point_names() == after.point_names()
        ):
            same |= {f"{name}.{place}" for place in before.point_names()}
        elif any(isinstance(before, kind) and isinstance(after, kind) for kind in (Ground, MaterialPoint)):
            same |= {*scene.coordinates_of(name)}
    return same


def _live(older: Program, program: Program, names: set[str]) -> Iterator[tuple[NativeFunction, Any]]:
    """Yields the action that copies the current values of common live parameters, if there are any."""
    keys = [key for key in program.places if {key[0], key[0].partition(".")[0]} & names]  # post.x: of post
    taken, placed = _in_order(older.places, program.places, keys)
    if taken.size:
        yield carry_numbers, CarriedNumbers(older.parameters.own, taken, program.parameters.own, placed)


def _gates(older: Program, program: Program) -> Iterator[tuple[NativeFunction, Any]]:
    """Yields the actions that copy the weights of common gates; others begin as their inputs are."""
    before, after = ({name: i for i, name in enumerate(one.parameters.gates)} for one in (older, program))
    taken, placed = _in_order(before, after, after)
    if taken.size:
        yield carry_numbers, CarriedNumbers(older.parameters.phases[0], taken, program.parameters.phases[0], placed)
    if after:
        yield apply_gates, GateNumbers(program.record.parameters)


def _remembered(older: Program, program: Program, links: set[str]) -> Iterator[tuple[NativeFunction, Any]]:
    """Yields the actions that copy the memory of common links, after `initialize` has reset it."""
    for one, other in product(older.parts, program.parts):
        before, after = one.memory, other.memory
        if before is None or after is None or one.add_forces is not other.add_forces:
            continue
        there, here = ({name: i for i, name in enumerate(memory.modules)} for memory in (before, after))
        taken, placed = _in_order(there, here, links)
        if taken.size:
            for source, target in zip(before.columns.values(), after.columns.values(), strict=True):
                yield carry_numbers, CarriedNumbers(source, taken, target, placed)


def _in_order(
    there: Mapping[Any, int], here: Mapping[Any, int], keys: Iterable[Any]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Returns the indices of the common keys in each, in the order of memory."""
    pairs = sorted((there[key], here[key]) for key in keys if key in there and key in here)
    taken, placed = np.array(pairs, np.uint32).reshape(-1, 2).T
    return np.ascontiguousarray(taken), np.ascontiguousarray(placed)
