"""Structures as forces alone, for schemes that move all points alike.

The forces in a string are added up in one pass over contiguous memory; in any other structure link by link, from its
`elements()`. The share of a live value is found from the structure with that value at one and the others at zero.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import fma
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PresentType, live_shares, masses_of
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.cordis.modules.link import Ends, pull_ends, stretch
from hapsim.cordis.modules.string import STRING, StringRows, place_borders, rows_of
from hapsim.scene import Scene

_ONE = np.uint64(1)


class StringForces(NamedTuple):
    """S strings: K, B/T and friction/T in N/m; shape (S,)."""

    rows: StringRows
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column


class WeightedLinks(NamedTuple):
    """L links inside structures. Link i's stiffness and damping are `value[owner[i]]` times its weights."""

    ends: Ends
    owner: NDArray[np.uint32]
    of_stretch: Column
    of_growth: Column
    value: Column


class WeightedLinksToRest(NamedTuple):
    """L links inside structures whose second end stays at `rest`, in m."""

    point: NDArray[np.uint32]
    rest: Column
    owner: NDArray[np.uint32]
    of_stretch: Column
    of_growth: Column
    value: Column


def first_moved(scene: Scene) -> int:
    """Returns the number of the first point that the scene moves; later ones are masses or borders of structures."""
    return len(scene.device_points) + len(scene.grounds)


def mobility_of_all(scene: Scene, context: BuildContext) -> Column:
    """Returns T²/m in m/N of all points from `first_moved` on; 0 for borders."""
    start = first_moved(scene)
    mobility = np.zeros(context.state.force.size - start, context.real)
    for name, mass in masses_of(scene):
        mobility[context.number[name] - start] = context.mobility(mass)
    return mobility


def expanded_forces(present: PresentType, context: BuildContext) -> tuple[Batch, ...]:
    """Returns the parts that add up the forces inside this type's modules, and move nothing."""
    kind, modules, columns = present
    if kind.layout is None:  # points, between which there is no force
        return ()
    if kind is STRING:
        return (Batch(StringForces(rows_of(modules, context), *columns), add_forces=add_string_forces),)
    return weighted_links_of(present, context)


def weighted_links_of(present: PresentType, context: BuildContext) -> tuple[Batch, ...]:
    """Returns the parts of the links inside structures of any kind."""
    lists: dict[tuple[str | None, bool], list[Any]] = {}
    values: dict[str | None, Column] = {None: np.ones(len(present.modules), context.real)}
    for owner, (name, structure) in enumerate(present.modules.items()):
        values |= zip(structure.live, present.columns, strict=True)
        places = [context.number[f"{name}.{place}"] for place in structure.point_names()]
        for field, unit, weight in live_shares(structure, context.rate):
            for first, second, k, z in unit.elements().links:
                if k or z:
                    weights = (owner, k / weight, z * context.rate / weight)
                    second_end = structure.position if second < 0 else places[second]
                    lists.setdefault((field, second < 0), []).append((places[first], second_end, *weights))
    return tuple(_part(entries, at_rest, values[field], context) for (field, at_rest), entries in lists.items())


def _part(entries: list[Any], at_rest: bool, value: Column, context: BuildContext) -> Batch:
    first, second, owner, of_stretch, of_growth = zip(*entries, strict=True)
    point = np.array(first, np.uint32)
    weights = (np.array(owner, np.uint32), np.array(of_stretch, context.real), np.array(of_growth, context.real))
    if at_rest:
        numbers = WeightedLinksToRest(point, np.array(second, context.real), *weights, value)
        return Batch(numbers, add_forces=add_forces_to_rest)
    ends = Ends(point, np.array(second, np.uint32))
    return Batch(WeightedLinks(ends, *weights, value), add_forces=add_forces)


@action
def add_string_forces(strings, state):
    """Adds the forces of all links and frictions of every string."""
    strings, state = value_of(strings), value_of(state)
    rows = strings.rows
    for s in range(np.uint64(rows.first.size)):
        place_borders(rows, s, state.position)
        place_borders(rows, s, state.previous)
        first, size = rows.first[s] - _ONE, rows.masses[s] + np.uint64(2)
        _add_string_forces(
            state.position[first : first + size],
            state.previous[first : first + size],
            state.force[first : first + size],
            strings.stiffness[s],
            strings.damping_per_sample[s],
            strings.friction_per_sample[s],
        )


@fma
def _add_string_forces(x, before, force, stiffness, damping, friction):
    for i in range(np.uint64(x.size - 2)):
        here, right = i + _ONE, i + np.uint64(2)
        bend = (x[i] - x[here]) + (x[right] - x[here])
        bend_before = (before[i] - before[here]) + (before[right] - before[here])
        force[here] += stiffness * bend + damping * (bend - bend_before) - friction * (x[here] - before[here])


@action
def add_forces(links, state):
    """Adds the force of every link."""
    links, state = value_of(links), value_of(state)
    for i in range(np.uint64(links.owner.size)):
        d = stretch(links.ends, i, state.position)
        growth = d - stretch(links.ends, i, state.previous)
        value = links.value[links.owner[i]]
        pull_ends(links.ends, i, value * (links.of_stretch[i] * d + links.of_growth[i] * growth), state.force)


@action
def add_forces_to_rest(links, state):
    """Adds the force of every link."""
    links, state = value_of(links), value_of(state)
    for i in range(np.uint64(links.owner.size)):
        p = links.point[i]
        d, growth = state.position[p] - links.rest[i], state.position[p] - state.previous[p]
        value = links.value[links.owner[i]]
        state.force[p] -= value * (links.of_stretch[i] * d + links.of_growth[i] * growth)
