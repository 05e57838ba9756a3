"""What a program takes over from the one before it, between two samples of a running loop.

Whatever both scenes have under the same name and of the same type goes on: points with their positions and velocities,
live parameters from where they are, and what links remember. What is new begins as its scene says, at the hands that
are there. A structure goes on where it has as many masses as before; a material point may become one of another type,
as a mass a cell.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling.native import value_of
from hapsim.cordis.dispatch import NativeFunction, action
from hapsim.cordis.program import Program, numbers_of, places_of_values
from hapsim.cordis.tick_state import Column
from hapsim.scene import Ground, Scene
from hapsim.scene.modules import MaterialPoint, Structure


class CarriedPoints(NamedTuple):
    """Points of an older program, PROGRAM, by number there, `taken`, and here, `placed`. `rows`: (3, N) its positions,
    in m."""

    older: Any
    rows: Column
    taken: NDArray[np.uint32]
    placed: NDArray[np.uint32]


class CarriedNumbers(NamedTuple):
    """Numbers of an older program, source[taken], that become target[placed]."""

    source: Column
    taken: NDArray[np.uint32]
    target: Column
    placed: NDArray[np.uint32]


@action
def carry_points(points, state):
    """Puts every point where it is and was."""
    points, state = value_of(points), value_of(state)
    turn = points.older.turn
    here, before = points.rows[turn], points.rows[turn - 1 if turn > 0 else 2]
    for i in range(np.uint64(points.taken.size)):
        state.position[points.placed[i]] = here[points.taken[i]]
        state.previous[points.placed[i]] = before[points.taken[i]]


@action
def carry_numbers(numbers, _state):
    """Copies them."""
    numbers = value_of(numbers)
    for i in range(np.uint64(numbers.taken.size)):
        numbers.target[numbers.placed[i]] = numbers.source[numbers.taken[i]]


def take_over_from(older: Program, older_scene: Scene, program: Program, scene: Scene) -> None:
    """Prepares `program`, of `scene`, to follow `older`: what `hapsim.cordis.tick.take_over` calls."""
    points = _common_points(older_scene, scene)
    older.call("place", [(part.place, part.numbers) for part in older.parts if part.place is not None])
    there, here = _points_of(older_scene), _points_of(scene)
    taken, placed = _pairs((there[name], here[name]) for name in points)
    carried = CarriedPoints(older.record, older.rows, taken, placed)
    program.call("carry_points", [(carry_points, carried)])
    links = _common_links(older_scene, scene, points)
    program.call("carry_numbers", [*_live(older, older_scene, program, scene), *_remembered(older, program, links)])
    program.call("place", [(part.place, part.numbers) for part in program.parts if part.place is not None])
    program.call("resume", [(part.resume, part.numbers) for part in program.parts if part.resume is not None])


def _points_of(scene: Scene) -> dict[str, int]:
    """The number of each point by its name; of a hand, by its channel: that is what makes it the same hand."""
    hands = {name: f"channel {hand.channel}" for name, hand in scene.device_points.items()}
    return {hands.get(name, name): number for name, number in numbers_of(scene).items()}


def _common_points(older: Scene, scene: Scene) -> frozenset[str]:
    """The points of both scenes that are the same, by the names of `_points_of`."""
    hands = [{f"channel {hand.channel}" for hand in one.device_points.values()} for one in (older, scene)]
    same = hands[0] & hands[1]
    for name in older.modules.keys() & scene.modules.keys():
        before, after = older.modules[name], scene.modules[name]
        if (
            isinstance(before, Structure)
            and type(before) is type(after)
            and before.point_names() == after.point_names()
        ):
            same |= {f"{name}.{place}" for place in before.point_names()}
        elif any(isinstance(before, kind) and isinstance(after, kind) for kind in (Ground, MaterialPoint)):
            same.add(name)
    return frozenset(same)


def _common_links(older: Scene, scene: Scene, points: frozenset[str]) -> frozenset[str]:
    """The modules that remember the same: of the same type, and with the same points at their ends."""
    before, after = _ends(older), _ends(scene)
    return frozenset(
        name
        for name, ends in after.items()
        if ends == before.get(name)
        and type(older.modules[name]) is type(scene.modules[name])
        and points.issuperset(ends)
    )


def _ends(scene: Scene) -> dict[str, list[str]]:
    """The points at the ends of each link, by the names of `_points_of`; any other module has itself."""
    hands = {name: f"channel {hand.channel}" for name, hand in scene.device_points.items()}
    own = {name: [name] for name in scene.modules}
    return own | {name: [hands.get(end, end) for end in link.between] for name, link in scene.links.items()}


def _live(older: Program, older_scene: Scene, program: Program, scene: Scene) -> Iterable[tuple[NativeFunction, Any]]:
    """Live parameters, from where they are now, wherever a change has brought them."""
    there, here = places_of_values(older_scene), places_of_values(scene)
    taken, placed = _pairs((there[key], here[key]) for key in there.keys() & here.keys())
    if taken.size:
        yield carry_numbers, CarriedNumbers(older.parameters.values, taken, program.parameters.values, placed)


def _remembered(older: Program, program: Program, links: frozenset[str]) -> Iterable[tuple[NativeFunction, Any]]:
    """What links remember: after `initialize`, which has them begin anew."""
    memories = {type(part.numbers): part.memory for part in older.parts if part.memory is not None}
    for part in program.parts:
        before = memories.get(type(part.numbers))
        if part.memory is None or before is None:
            continue
        there, here = _indices(before.modules), _indices(part.memory.modules)
        taken, placed = _pairs((there[name], here[name]) for name in links & there.keys() & here.keys())
        if taken.size:
            for source, target in zip(before.columns, part.memory.columns, strict=True):
                yield carry_numbers, CarriedNumbers(source, taken, target, placed)


def _indices(names: Iterable[str]) -> Mapping[str, int]:
    return {name: i for i, name in enumerate(names)}


def _pairs(pairs: Iterable[tuple[int, int]]) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Both sides, in the order of memory."""
    taken, placed = np.array(sorted(pairs), np.uint32).reshape(-1, 2).T
    return np.ascontiguousarray(taken), np.ascontiguousarray(placed)
