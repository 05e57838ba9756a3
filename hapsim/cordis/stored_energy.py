"""What a scene has stored, and a tank for what live changes add to it.

A change of a parameter at a frozen state changes the energy that is stored by

    W = V(new parameters, x) - V(old parameters, x),

which for a link that is stretched by x and stiffened by dK is dK x²/2, with its sign; for a ground, a rest length or a
distance that moves it is force times way. That is all that a change can add. V is summed over the springs of the scene:
links, contacts, bristles that stick, plectra that grip, detents, clicks, what holds a cell, and the links of which
strings and membranes are made. Of a spring at a hand, and of the bottom of a click, no more counts than a force at its
limit gives back. While one scene follows another,
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
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.compiled import new_record
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.cordis.build_context import live_shares, masses_of
from hapsim.scene import Buffer, Click, Detent, Friction, Ground, Nonlinear, Plectrum, Scene
from hapsim.scene.modules import Link

SPRING, CONTACT, BRISTLE, GRIP, CURVE, SINE, SNAP, NOTCH, CLICK = range(9)
_DETENTS = {"sine": SINE, "snap": SNAP, "notch": NOTCH}

_SPRING = np.dtype(
    [
        ("kind", np.int64),
        ("ends", np.int64, (2,)),  # numbers of points,
        ("at", np.uint64, (2,)),  # or, where not 0, addresses of where they stand
        ("stiffness", np.uint64),  # address of K, N/m; of a curve's points
        ("share", np.float64),  # of that
        ("offset", np.uint64),  # address of the distance at which it is not stretched; 0: none
        ("most", np.float64),  # N, beyond which no hand feels it
        ("side", np.uint64),  # address of what a bristle or a plectrum remembers
        ("force", np.uint64),  # address of a bristle's force while it slides
        ("shape", np.uint64, (4,)),  # addresses of a detent's pitch, depth, sharpness; of a click's travel to bottom
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
        ("live", np.uint64, (2,)),  # where the live values begin and end
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

EVALUATE = types.float64(*[types.uint64] * 4)
call_evaluate = function_at(EVALUATE)
"""Calls `evaluate`, with its arguments."""

tank_at, stored_at = record_at(TANK), record_at(STORED)
_springs_at, _points_at = array_at(_SPRING), array_at(np.int64)
_doubles_at, _singles_at = array_at(np.float64), array_at(np.float32)


@inlined
def number_at(address, i, single):
    """Number i of those at an address."""
    if single:
        return np.float64(_singles_at(address, i + 1)[np.uint64(i)])
    return _doubles_at(address, i + 1)[np.uint64(i)]


@inlined
def put_number(address, i, single, number):
    """Puts a number there."""
    if single:
        _singles_at(address, i + 1)[np.uint64(i)] = number
    else:
        _doubles_at(address, i + 1)[np.uint64(i)] = number


@native(EVALUATE.return_type, *EVALUATE.args)
def evaluate(stored, position, previous, way):
    """J that springs and masses hold, for `way` = 0; else what the springs hold more with the live values that are
    `way` bytes further on. `position` and `previous`: addresses of rows."""
    stored = stored_at(stored)
    springs, total = _springs_at(stored.springs, stored.count), 0.0
    for i in range(stored.count):
        total += _spring_holds(stored, springs[i], position, way)
        if way != 0:
            total -= _spring_holds(stored, springs[i], position, np.uint64(0))
    count = stored.mass_count if way == 0 else 0
    points, masses = _points_at(stored.points, count), _doubles_at(stored.masses, count)
    for i in range(count):
        step = number_at(position, points[i], stored.single) - number_at(previous, points[i], stored.single)
        total += masses[i] * step * step
    return total


@helper
def _spring_holds(stored, spring, position, way):
    d = _end(stored, spring, position, way, 0) - _end(stored, spring, position, way, 1)
    if spring.offset:
        d -= _value(stored, spring.offset, way)
    if spring.kind == CURVE:
        return _curve_holds(spring.stiffness, d)
    if spring.kind == CLICK:
        return _click_holds(stored, spring, -d, way)
    if spring.kind >= SINE:
        return _detent_holds(stored, spring, d, way)
    stiffness = spring.share * _value(stored, spring.stiffness, way)
    side = number_at(spring.side, 0, stored.single) if spring.side else 0.0
    if (spring.kind == CONTACT and d > 0.0) or (spring.kind == GRIP and side * d > 0.0):
        return 0.0
    if spring.kind == BRISTLE and side != 0.0:
        d = _value(stored, spring.force, way) / stiffness
    if stiffness * abs(d) > spring.most:
        return spring.most * (abs(d) - 0.5 * spring.most / stiffness)
    return 0.5 * stiffness * d * d


@inlined
def _end(stored, spring, position, way, end):
    if spring.at[end]:
        return _value(stored, spring.at[end], way)
    return number_at(position, spring.ends[end], stored.single)


@helper
def _value(stored, address, way):
    """A live value, `way` bytes further on, or a constant."""
    if address >= stored.live[0] and address < stored.live[1]:
        address += way
    return number_at(address, 0, stored.single)


@helper
def _curve_holds(address, d):
    """Straight between its points, level beyond the ends."""
    n = np.int64(_doubles_at(address, 1)[0])
    points = _doubles_at(address, 1 + 3 * n)[1:]
    i = 0
    while i < n - 1 and d > points[i + 1]:
        i += 1
    way = d - points[i]
    slope = (points[n + i + 1] - points[n + i]) / (points[i + 1] - points[i]) if way > 0 and i < n - 1 else 0.0
    return points[2 * n + i] + way * (points[n + i] + 0.5 * slope * way)


@helper
def _detent_holds(stored, spring, d, way):
    """What its force does from the nearest rest on: up to `depth` over `rise`, and down to 0 over `fall`."""
    pitch, depth = _value(stored, spring.shape[0], way), _value(stored, spring.shape[1], way)
    away = abs(d - pitch * math.floor(d / pitch + 0.5))
    if spring.kind == SINE:
        return depth * pitch / math.pi * math.sin(math.pi * away / pitch) ** 2
    sharpness = _value(stored, spring.shape[2], way)
    fall = 0.5 * pitch / (sharpness + 1.0) if spring.kind == SNAP else 0.25 * pitch / sharpness
    rise = sharpness * fall if spring.kind == SNAP else fall
    if away < rise:
        return 0.5 * depth * away * away / rise
    left = max(rise + fall - away, 0.0)
    return 0.5 * depth * (rise + fall - left * left / fall)


@helper
def _click_holds(stored, spring, pressed, way):
    """From the least on, which one that stays down has where the force is 0 again: beyond 3/4 of its travel."""
    travel, peak = _value(stored, spring.shape[0], way), _value(stored, spring.shape[1], way)
    drop, bottom = _value(stored, spring.shape[2], way), _value(stored, spring.shape[3], way)
    slope, most = 2.0 * peak / travel, spring.most
    down = 0.75 * travel + (drop - peak) / slope
    if down > travel:
        down = travel + (drop - 1.5 * peak) / bottom
    least = min(_click_does(travel, peak, drop, bottom, most, down), 0.0) if drop > peak else 0.0
    return _click_does(travel, peak, drop, bottom, most, pressed) - least


@helper
def _click_does(travel, peak, drop, bottom, most, pressed):
    """The work of pressing it, J; on its bottom with no more than `most` N."""
    quarter, slope = 0.25 * travel, 2.0 * peak / travel
    work = _ramp_does(min(max(pressed, 0.0), 2.0 * quarter), 0.0, slope)
    work += _ramp_does(min(max(pressed - 2.0 * quarter, 0.0), quarter), peak, -drop / quarter)
    work += _ramp_does(min(max(pressed - 3.0 * quarter, 0.0), quarter), peak - drop, slope)
    force, way = 1.5 * peak - drop, max(pressed - travel, 0.0)
    bent = min(way, max(most - force, 0.0) / bottom)
    work += _ramp_does(bent, force, bottom)
    return work + (way - bent) * most if bent < way else work


@inlined
def _ramp_does(way, force, slope):
    return way * (force + 0.5 * slope * way)


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
    """Fills a TANK: `capacity_j` in J, `refill_j` in J a sample."""

    def __init__(self, record: Any, *, capacity_j: float, refill_j: float) -> None:
        record.address = self.address = address_of(record)
        record.level = record.capacity = capacity_j
        record.refill = refill_j


class StoredEnergy:
    """Computes the energy of a program; what that needs is kept in the program's PARAMETERS from then on."""

    def __init__(self, program: Any, scene: Scene, tank: Tank, force_limit: float) -> None:
        """`program`: a Program, which is not imported here: the loop would be compiled anew with every module.
        `force_limit`: N, of the hands."""
        self._program, self._scene, self._force_limit = program, scene, force_limit
        self._kept: list[Any] = []
        connected = _connected(scene)
        springs = [*self._links(connected), *self._points(connected), *self._structures(connected)]
        masses = [(name, mass) for name, mass in masses_of(scene) if _module(scene, name) in connected]
        values = program.parameters.values
        record = self._record = new_record(STORED)
        record.address, record.evaluate, record.tank = address_of(record), evaluate.address(), tank.address
        record.single = values.dtype == np.float32
        record.live = values.ctypes.data, values.ctypes.data + values.nbytes
        record.springs, record.count = self._keep(springs, _SPRING), len(springs)
        record.points = self._keep([program.numbers[name] for name, _ in masses], np.int64)
        record.masses = self._keep([0.5 * mass * scene.step_rate**2 for _, mass in masses], np.float64)
        record.mass_count = len(masses)
        program.record.parameters.stored = record.address

    def _keep(self, values: Any, dtype: Any = None) -> int:
        """The address of constants; `dtype`: the scene's precision unless given."""
        self._kept.append(np.atleast_1d(np.asarray(values, dtype or self._program.rows.dtype)))
        return address_of(self._kept[-1])

    def _live(self, name: str, field: str) -> int:
        """The address of a module's value that may change, or of a constant where it may not."""
        place = self._program.places.get((name, field))
        if place is None:
            return self._keep(getattr(self._scene.modules[name], field))
        return address_of(self._program.parameters.values[place : place + 1])

    def _remembered(self, name: str) -> list[int]:
        """The addresses of what a module remembers."""
        memories = [part.memory for part in self._program.parts if part.memory and name in part.memory.modules]
        return [address_of(column[memory.modules.index(name) :]) for memory in memories for column in memory.columns]

    def _links(self, connected: frozenset[str]) -> Iterator[tuple[Any, ...]]:
        scene, grounds, hands = self._scene, self._scene.grounds, self._scene.device_points  # each is made anew
        for name, link in scene.links.items():
            if not connected & {*_nodes(scene, link)}:
                continue
            ends = [self._program.numbers[end] for end in link.between]
            at = [self._live(end, "position") if end in grounds else 0 for end in link.between]
            most = self._force_limit if any(end in hands for end in link.between) else np.inf
            offset = side = force = 0
            if isinstance(link, Nonlinear):
                if link.force_over_distance is not None:
                    yield _spring(CURVE, ends, at, self._keep(_potential(link.force_over_distance), np.float64))
            elif isinstance(link, Detent | Click):
                kind = CLICK if isinstance(link, Click) else _DETENTS[link.shape]
                fields = ("travel", "peak", "drop", "bottom") if kind == CLICK else ("pitch", "depth", "sharpness")
                shape = [self._live(name, field) for field in fields]
                yield _spring(kind, ends, at, most=most, shape=shape)
            elif hasattr(link, "stiffness"):
                kind = {Buffer: CONTACT, Plectrum: GRIP, Friction: BRISTLE}.get(type(link), SPRING)
                if kind == CONTACT:
                    offset = self._live(name, "distance")
                elif kind == GRIP:
                    (side,) = self._remembered(name)
                elif kind == BRISTLE:
                    (offset, side), force = self._remembered(name), self._live(name, "force")
                yield _spring(kind, ends, at, self._live(name, "stiffness"), 1.0, offset, most, side, force)

    def _points(self, connected: frozenset[str]) -> Iterator[tuple[Any, ...]]:
        for name, point in self._scene.material_points.items():
            if name in connected and point.held_by() is not None:
                at = [0, self._live(name, "rest")]
                ends = [self._program.numbers[name], 0]
                yield _spring(SPRING, ends, at, self._live(name, "stiffness"))

    def _structures(self, connected: frozenset[str]) -> Iterator[tuple[Any, ...]]:
        structures: dict[str, Any] = {name: one for name, one in self._scene.structures.items() if name in connected}
        for name, structure in structures.items():
            numbers = [self._program.numbers[f"{name}.{place}"] for place in structure.point_names()]
            rest, one = self._keep(structure.position), self._keep(1.0)
            for field, unit, _ in live_shares(structure, self._scene.step_rate):
                stiffness = one if field is None else self._live(name, field)
                for first, second, share, _ in unit.elements().links:
                    ends, at = [numbers[first], numbers[second] if second >= 0 else 0], [0, 0 if second >= 0 else rest]
                    if share:
                        yield _spring(SPRING, ends, at, stiffness, share)


def _spring(
    kind: int,
    ends: Sequence[int],
    at: Sequence[int],
    stiffness: int = 0,
    share: float = 1.0,
    offset: int = 0,
    most: float = np.inf,
    side: int = 0,
    force: int = 0,
    shape: Sequence[int] = (),
) -> tuple[Any, ...]:
    """A _SPRING's fields, in its order."""
    return kind, ends, at, stiffness, share, offset, most, side, force, (*shape, 0, 0, 0, 0)[:4]


def _module(scene: Scene, point: str) -> str:
    return point if point in scene.modules else point.partition(".")[0]


def _nodes(scene: Scene, link: Link) -> list[str]:
    """The modules at its ends that can move: a structure is one."""
    names = [_module(scene, end) for end in link.between]
    return [name for name in names if not isinstance(scene.modules[name], Ground)]


def _connected(scene: Scene) -> frozenset[str]:
    """The modules that a chain of links connects to a hand."""
    found, pairs = set(scene.device_points), [_nodes(scene, link) for link in scene.links.values()]
    while more := {name for pair in pairs if found & {*pair} for name in pair} - found:
        found |= more
    return frozenset(found)


def _potential(curve: Any) -> list[float]:
    """How many points, where they are (m), the tension (N) and what is stored there (J), from the least on: that of a
    point, or where the tension rises through 0 between two."""
    at, tension = np.array(curve, np.float64).T
    way, rise = np.diff(at), np.diff(tension)
    stored = np.concatenate([[0.0], np.cumsum(0.5 * (tension[1:] + tension[:-1]) * way)])
    rests = (tension[:-1] < 0.0) & (tension[1:] > 0.0)
    least = stored[:-1][rests] - 0.5 * tension[:-1][rests] ** 2 * way[rests] / rise[rests]
    return [len(at), *at, *tension, *(stored - min(stored.min(), least.min(initial=np.inf)))]
