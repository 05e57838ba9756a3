"""What a scene has stored, and a tank for what live changes add to it.

A change of a parameter at a frozen state changes the energy that is stored by

    W = V(new parameters, x) - V(old parameters, x),

which for a link that is stretched by x and stiffened by dK is dK x²/2, with its sign; for a ground, a rest length or a
distance that moves it is force times way. That is all that a change can add. V is summed over the springs of the scene:
links, contacts, bristles that stick, plectra that grip, what holds a cell, and the links of which strings and membranes
are made. Of a spring at a hand no more counts than a force at its limit gives back. While one scene follows another,
the force w F_new + (1 - w) F_old is that of a scene that has stored w H_new + (1 - w) H_old, so that a step dw adds
dw (H_new - H_old), with kinetic energy. A module that no chain of links connects to a hand adds nothing.

**The tank** (variable stiffness: Ferraguti, Secchi and Fantuzzi, ICRA 2013). What a change adds is taken from it, what
a change takes away is put back, and it fills with a constant power. Where it has too little, the change goes on only as
far as it lasts: all its parameters together, which so are slowed. What takes energy away is never slowed. So changes
give a hand no more than what the tank holds and that power, whatever friction there is. `spent` is what they added:
the energy guard counts it as the scene's own, and counts swings anew after a change (loop/guards/energy_guard.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.compiled import new_record
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.scene import Buffer, Friction, Ground, Nonlinear, Plectrum, Scene
from hapsim.scene.modules import Link, MaterialPoint, Structure

SPRING, CONTACT, BRISTLE, GRIP, CURVE = range(5)

_SPRING = np.dtype(
    [
        ("kind", np.int64),
        ("ends", np.int64, (2,)),  # numbers of points,
        ("at", np.uint64, (2,)),  # or, where not 0, addresses of where they stand
        ("stiffness", np.uint64),  # address of K, N/m
        ("share", np.float64),  # of that
        ("offset", np.uint64),  # address of the distance at which it is not stretched; 0: none
        ("most", np.float64),  # N, beyond which no hand feels it
        ("side", np.uint64),  # address of what a bristle or a plectrum remembers
        ("force", np.uint64),  # address of a bristle's force while it slides
    ],
    align=True,
)

STORED = np.dtype(
    [
        ("address", np.uint64),  # of all this,
        ("evaluate", np.uint64),  # and of `evaluate`
        ("single", np.int64),  # 1: numbers of single precision
        ("springs", np.uint64),  # address of them,
        ("count", np.int64),  # and how many
        ("points", np.uint64),  # addresses of the numbers of points with a mass,
        ("masses", np.uint64),  # and of m/(2 T²), N/m
        ("mass_count", np.int64),
        ("tank", np.uint64),  # address of a TANK
    ],
    align=True,
)

TANK = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("level", np.float64),  # J
        ("capacity", np.float64),  # J
        ("refill", np.float64),  # J a sample
        ("spent", np.float64),  # J, added by changes, all in all
        ("slowed_ticks", np.int64),  # samples in which a change was slowed
        ("changed_ticks", np.int64),  # samples in which parameters changed or one scene faded into another
    ],
    align=True,
)

EVALUATE = types.float64(*[types.uint64] * 3, types.int64)
call_evaluate = function_at(EVALUATE)
"""Calls `evaluate`, with its arguments."""

tank_at, stored_at = record_at(TANK), record_at(STORED)
_springs_at, _points_at, _masses_at = array_at(_SPRING), array_at(np.int64), array_at(np.float64)
_doubles_at, _singles_at = array_at(np.float64), array_at(np.float32)
_REACH = 1 << 40


@native(EVALUATE.return_type, *EVALUATE.args)
def evaluate(stored, position, previous, moving):
    """J, of the springs; `moving`: and of the masses. `position` and `previous`: addresses of rows."""
    stored = stored_at(stored)
    if stored.single:
        here, before = _singles_at(position, _REACH), _singles_at(previous, _REACH)
        return _springs_hold(stored, here, _singles_at) + _masses_hold(stored, here, before, moving)
    here, before = _doubles_at(position, _REACH), _doubles_at(previous, _REACH)
    return _springs_hold(stored, here, _doubles_at) + _masses_hold(stored, here, before, moving)


@helper
def _springs_hold(stored, position, array):
    springs, total = _springs_at(stored.springs, stored.count), 0.0
    for i in range(stored.count):
        spring = springs[i]
        first = array(spring.at[0], 1)[0] if spring.at[0] else position[np.uint64(spring.ends[0])]
        second = array(spring.at[1], 1)[0] if spring.at[1] else position[np.uint64(spring.ends[1])]
        d = np.float64(first) - np.float64(second)
        if spring.offset:
            d -= array(spring.offset, 1)[0]
        if spring.kind == CURVE:
            total += _curve_holds(spring.stiffness, d)
            continue
        stiffness = spring.share * array(spring.stiffness, 1)[0]
        side = array(spring.side, 1)[0] if spring.side else 0.0
        if (spring.kind == CONTACT and d > 0.0) or (spring.kind == GRIP and side * d > 0.0):
            continue
        if spring.kind == BRISTLE and side != 0.0:
            d = array(spring.force, 1)[0] / stiffness
        if stiffness * abs(d) > spring.most:
            total += spring.most * (abs(d) - 0.5 * spring.most / stiffness)
        else:
            total += 0.5 * stiffness * d * d
    return total


@helper
def _curve_holds(address, d):
    """Straight between its points, level beyond the ends."""
    n = np.int64(_doubles_at(address, 1)[0])
    points = _doubles_at(address, _REACH)[1:]
    i = 0
    while i < n - 1 and d > points[i + 1]:
        i += 1
    way = d - points[i]
    slope = (points[n + i + 1] - points[n + i]) / (points[i + 1] - points[i]) if way > 0 and i < n - 1 else 0.0
    return points[2 * n + i] + way * (points[n + i] + 0.5 * slope * way)


@helper
def _masses_hold(stored, position, previous, moving):
    count, total = stored.mass_count if moving else 0, 0.0
    points, masses = _points_at(stored.points, count), _masses_at(stored.masses, count)
    for i in range(count):
        way = np.float64(position[np.uint64(points[i])]) - np.float64(previous[np.uint64(points[i])])
        total += masses[i] * way * way
    return total


@inlined
def share_that_lasts(tank, work):
    """Of a step that adds so much, J."""
    if work <= tank.level:
        return 1.0
    tank.slowed_ticks += 1
    return max(tank.level, 0.0) / work if work < np.inf else 0.0


@inlined
def left_of(share):
    """Which part of a ramp is left where so much of its way, 3 s² - 2 s³, is done: 1 - s."""
    return 0.5 + math.sin(math.asin(1.0 - 2.0 * share) / 3.0)


@inlined
def spend(tank, work):
    """Subtracts the energy that a change added in this sample; ignores NaN and infinity."""
    tank.changed_ticks += 1
    if abs(work) < np.inf:
        tank.level = min(tank.capacity, tank.level - work)
        tank.spent += work


class Tank:
    """Fills a TANK."""

    def __init__(self, record: Any, *, capacity_j: float, refill_j: float) -> None:
        """`refill_j`: J a sample."""
        record.address = address_of(record)
        record.level = record.capacity = capacity_j
        record.refill = refill_j
        self.address = int(record.address)


class StoredEnergy:
    """What tells the energy of a program, and keeps what that needs: in the PARAMETERS of the program from then on."""

    def __init__(self, program: Any, scene: Scene, tank: Tank, force_limit: float) -> None:
        """`program`: a Program, which is not imported here: the loop would be compiled anew with every module.
        `force_limit`: N, of the hands."""
        self._program, self._scene, self._force_limit = program, scene, force_limit
        self._number, self._place = program.numbers, program.places
        self._memory = {
            name: [column[i : i + 1] for column in part.memory.columns]
            for part in program.parts
            if part.memory is not None
            for i, name in enumerate(part.memory.modules)
        }
        self._constants: list[Any] = []
        connected = _connected(scene)
        links = [self._of_link(name, link) for name, link in scene.links.items() if connected & {*_nodes(scene, link)}]
        cells = [self._of_point(name, point) for name, point in scene.material_points.items() if name in connected]
        alone = [one for one in (*links, *cells) if one is not None]
        structures = [
            row for name, one in scene.structures.items() if name in connected for row in self._of_structure(name, one)
        ]
        self._springs = np.array([*alone, *structures], _SPRING)
        masses = [one for name in connected for one in self._masses_of(name)]
        self._points = np.array([number for number, _ in masses], np.int64)
        self._masses = np.array([0.5 * mass * scene.rate**2 for _, mass in masses], np.float64)
        record = self._record = new_record(STORED)
        record.address, record.evaluate, record.tank = address_of(record), evaluate.address(), tank.address
        record.single = program.rows.dtype == np.float32
        record.springs, record.points, record.masses = map(address_of, (self._springs, self._points, self._masses))
        record.count, record.mass_count = len(self._springs), len(masses)
        program.record.parameters.stored = record.address

    def _constant(self, values: Any, dtype: Any = None) -> int:
        self._constants.append(np.atleast_1d(np.asarray(values, dtype or self._program.rows.dtype)))
        return address_of(self._constants[-1])

    def _live(self, name: str, column: int, otherwise: float) -> int:
        """The address of a value that may change, or of a constant where it may not."""
        place = self._place.get((name, column))
        if place is None:
            return self._constant(otherwise)
        return address_of(self._program.parameters.values[place : place + 1])

    def _ends(self, link: Link) -> tuple[list[int], list[int]]:
        grounds = self._scene.grounds
        at = [self._live(end, 0, grounds[end].position) if end in grounds else 0 for end in link.between]
        return [self._number[end] for end in link.between], at

    def _of_link(self, name: str, link: Link) -> tuple[Any, ...] | None:
        numbers, at = self._ends(link)
        most = self._force_limit if any(end in self._scene.device_points for end in link.between) else np.inf
        memory = [address_of(one) for one in self._memory.get(name, ())]
        if isinstance(link, Nonlinear):
            if link.force_over_distance is None:
                return None
            return CURVE, numbers, at, self._constant(_potential(link.force_over_distance), float), 1.0, 0, most, 0, 0
        if isinstance(link, Friction):
            stiffness, force = self._live(name, 2, link.stiffness), self._live(name, 0, link.force)
            return BRISTLE, numbers, at, stiffness, 1.0, memory[0], most, memory[1], force
        if not hasattr(link, "stiffness"):
            return None
        offset = self._live(name, 2, link.distance) if isinstance(link, Buffer) else 0
        kind = CONTACT if isinstance(link, Buffer) else GRIP if isinstance(link, Plectrum) else SPRING
        side = memory[0] if isinstance(link, Plectrum) else 0
        return kind, numbers, at, self._live(name, 0, link.stiffness), 1.0, offset, most, side, 0

    def _of_point(self, name: str, point: MaterialPoint) -> tuple[Any, ...] | None:
        held = point.held_by()
        if held is None:
            return None
        at = [0, self._live(name, 2, held.rest)]
        return SPRING, [self._number[name], 0], at, self._live(name, 0, held.stiffness), 1.0, 0, np.inf, 0, 0

    def _of_structure(self, name: str, structure: Any) -> Iterator[tuple[Any, ...]]:
        numbers = [self._number[f"{name}.{place}"] for place in structure.point_names()]
        rest, live = self._constant(structure.position), self._live(name, 0, structure.stiffness)
        plain = {"damping": 0.0, "friction": 0.0}
        kinds = [(live, structure.model_copy(update=plain | {"stiffness": 1.0, "bending": 0.0}))]
        if getattr(structure, "bending", 0.0):
            kinds.append((self._constant(1.0), structure.model_copy(update=plain | {"stiffness": 0.0})))
        for stiffness, one in kinds:
            for first, second, share, _ in one.elements().links:
                ends = [numbers[first], numbers[second] if second >= 0 else 0]
                if share:
                    yield SPRING, ends, [0, 0 if second >= 0 else rest], stiffness, share, 0, np.inf, 0, 0

    def _masses_of(self, name: str) -> Iterator[tuple[int, float]]:
        module = self._scene.modules[name]
        if isinstance(module, Structure):
            points = zip(module.point_names(), module.elements().masses, strict=True)
            yield from ((self._number[f"{name}.{place}"], mass) for place, mass in points)
        elif isinstance(module, MaterialPoint):
            yield self._number[name], module.mass


def _nodes(scene: Scene, link: Link) -> list[str]:
    """The modules at its ends that can move: a structure is one."""
    names = [end if end in scene.modules else end.partition(".")[0] for end in link.between]
    return [name for name in names if not isinstance(scene.modules[name], Ground)]


def _connected(scene: Scene) -> frozenset[str]:
    """The modules that a chain of links connects to a hand."""
    found, pairs = set(scene.device_points), [_nodes(scene, link) for link in scene.links.values()]
    while more := {name for pair in pairs if found & {*pair} for name in pair} - found:
        found |= more
    return frozenset(found)


def _potential(curve: Any) -> list[float]:
    """How many points, where they are (m), the tension (N) and what is stored there (J), from the least on."""
    at, tension = np.array(curve, np.float64).T
    stored = np.concatenate([[0.0], np.cumsum(0.5 * (tension[1:] + tension[:-1]) * np.diff(at))])
    return [len(at), *at, *tension, *(stored - stored.min())]
