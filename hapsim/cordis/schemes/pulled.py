"""Structures as forces and nothing else, for schemes that move all points alike.

A string is pulled in one pass over contiguous memory. Any other structure is pulled link by link, as its `elements()`
say; what a live value of it does is found by taking it apart with that value at one and the others at zero.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.cordis.kinds import MASS, STRING
from hapsim.cordis.link import Ends, pull_ends, stretch
from hapsim.cordis.mass import mobility_of
from hapsim.cordis.schemes.scheme import Taken
from hapsim.cordis.string import Rows, free_ends, rows_of
from hapsim.scene import Scene

_ONE = np.uint64(1)


class StringForces(NamedTuple):
    """S strings: K, B/T and friction/T in N/m; shape (S,)."""

    rows: Rows
    stiffness: Column
    damping_per_sample: Column
    friction_per_sample: Column


class Shares(NamedTuple):
    """L links inside structures. Link i's stiffness and damping are its shares of `value[owner[i]]`."""

    ends: Ends
    owner: NDArray[np.uint32]
    of_stretch: Column
    of_growth: Column
    value: Column


class SharesAtRest(NamedTuple):
    """The same, of links whose second end stays at `rest`, in m."""

    point: NDArray[np.uint32]
    rest: Column
    owner: NDArray[np.uint32]
    of_stretch: Column
    of_growth: Column
    value: Column


def first_moved(scene: Scene) -> int:
    """The number of the first point that the scene moves; all after it are masses, or borders of structures."""
    return len(scene.device_points) + len(scene.grounds)


def moves_points(kind: Kind) -> bool:
    """Whether this kind of module has points that the scene moves."""
    return kind is MASS or kind.layout is not None


def mobility_of_all(scene: Scene, frame: Frame) -> Column:
    """T²/m in m/N of all points from `first_moved` on; 0 for borders."""
    start = first_moved(scene)
    mobility = np.zeros(frame.points - start, frame.real)
    for name, mass in masses_of(scene):
        mobility[frame.number[name] - start] = mobility_of(mass, frame)
    return mobility


def masses_of(scene: Scene) -> Iterator[tuple[str, float]]:
    """Every point that the scene moves, with its mass in kg."""
    for name, mass in (scene.masses | scene.cells).items():
        yield name, mass.mass
    for name, structure in scene.structures.items():
        for place, kilograms in zip(structure.places(), structure.elements().masses, strict=True):
            yield f"{name}.{place}", kilograms


def pulled(taken: Taken, frame: Frame) -> tuple[Any, ...]:
    """The parts that pull what this kind's modules move, and move nothing."""
    kind, modules, columns = taken
    if kind is MASS:
        return ()
    if kind is STRING:
        return (StringForces(rows_of(modules, frame), *columns),)
    return shares_of(taken, frame)


def shares_of(taken: Taken, frame: Frame) -> tuple[Any, ...]:
    """The links inside structures of any kind."""
    lists: dict[tuple[int, bool], list[Any]] = {}
    for owner, (name, structure) in enumerate(taken.modules.items()):
        places = [frame.number[f"{name}.{place}"] for place in structure.places()]
        for column, unit, weight in _units(taken.kind, structure, frame.rate):
            for first, second, k, z in unit.elements().links:
                if k or z:
                    share = (owner, k / weight, z * frame.rate / weight)
                    second_end = structure.position if second < 0 else places[second]
                    lists.setdefault((column, second < 0), []).append((places[first], second_end, *share))
    ones = np.ones(len(taken.modules), frame.real)
    values = [*taken.columns, ones]
    return tuple(_shares(entries, at_rest, values[column], frame) for (column, at_rest), entries in lists.items())


def _units(kind: Kind, structure: Any, rate: float) -> Iterator[tuple[int, Any, float]]:
    """The structure with one of its live values at 1 and all else at 0: which column that is, and what stands there.

    Last what cannot change, with all live values at 0: a column after the last one, of ones.
    """
    fixed = {"bending": 0.0} if "bending" in type(structure).model_fields else {}
    for live in structure.live:
        unit = structure.model_copy(update=fixed | {key: float(key == live) for key in structure.live})
        weights = [column[0] for column in kind.live([unit], rate)]
        (column,) = np.flatnonzero(weights)
        yield int(column), unit, weights[column]
    if fixed:
        yield len(kind.live([structure], rate)), structure.model_copy(update=dict.fromkeys(structure.live, 0.0)), 1.0


def _shares(entries: list[Any], at_rest: bool, value: Column, frame: Frame) -> Shares | SharesAtRest:
    first, second, owner, of_stretch, of_growth = zip(*entries, strict=True)
    point = np.array(first, np.uint32)
    shares = (np.array(owner, np.uint32), np.array(of_stretch, frame.real), np.array(of_growth, frame.real), value)
    if at_rest:
        return SharesAtRest(point, np.array(second, frame.real), *shares)
    return Shares(Ends(point, np.array(second, np.uint32), point.size, None), *shares)


@pulls(StringForces)
@inlined
def pull_strings(strings, moment):
    """Adds the forces of all links and frictions of every string."""
    rows = strings.rows
    for s in range(rows.border.size):
        free_ends(rows, s, moment.position)
        free_ends(rows, s, moment.previous)
        first, size = rows.border[s], rows.masses[s] + np.uint64(2)
        _pull_string(
            moment.position[first : first + size],
            moment.previous[first : first + size],
            moment.force[first : first + size],
            strings.stiffness[s],
            strings.damping_per_sample[s],
            strings.friction_per_sample[s],
        )


@fused
def _pull_string(x, before, force, stiffness, damping, friction):
    for i in range(np.uint64(x.size - 2)):
        here, right = i + _ONE, i + np.uint64(2)
        bend = (x[i] - x[here]) + (x[right] - x[here])
        bend_before = (before[i] - before[here]) + (before[right] - before[here])
        force[here] += stiffness * bend + damping * (bend - bend_before) - friction * (x[here] - before[here])


@pulls(Shares)
@inlined
def pull_shares(shares, moment):
    """Adds the force of every link."""
    for i in range(shares.owner.size):
        d = stretch(shares.ends, i, moment.position)
        growth = d - stretch(shares.ends, i, moment.previous)
        value = shares.value[shares.owner[i]]
        pull_ends(shares.ends, i, value * (shares.of_stretch[i] * d + shares.of_growth[i] * growth), moment.force)


@pulls(SharesAtRest)
@inlined
def pull_shares_at_rest(shares, moment):
    """Adds the force of every link."""
    for i in range(shares.owner.size):
        p = shares.point[i]
        d, growth = moment.position[p] - shares.rest[i], moment.position[p] - moment.previous[p]
        value = shares.value[shares.owner[i]]
        moment.force[p] -= value * (shares.of_stretch[i] * d + shares.of_growth[i] * growth)
