"""The energy stored in a scene, and a tank for the energy that live changes add.

A change of a parameter at a frozen state changes the energy that is stored by

    W = V(new parameters, x) - V(old parameters, x),

which for a link that is stretched by x and stiffened by dK is dK x²/2, with its sign; for a ground, a rest length or a
distance that moves it is force times way. A change can add no other energy. V is summed over the springs of the scene:
links, contacts, bristles that stick, ways between two branches, plectra that grip, detents, clicks, the springs of
cells, and the links inside strings and membranes. Those of shapes and guides are taken along the last tick's normal. A
spring at a hand, and the bottom of a click, count only up to the energy that a force at its limit gives back. During a
crossfade the force w F_new + (1 - w) F_old is that of a scene with the stored energy w H_new + (1 - w) H_old, so that a
step dw adds dw (H_new - H_old), with kinetic energy. A module that no chain of links connects to a hand adds nothing.

**The tank** (variable stiffness: Ferraguti, Secchi and Fantuzzi, ICRA 2013). Energy that a change adds is taken from
the tank, energy that a change removes is put back, and a constant power fills it. If it holds too little, the change
advances only as far as the tank allows, with all its parameters together. A change that removes energy is never slowed.
So changes give a hand no more than the tank's content and that power, whatever the friction. `spent` is the added
energy: the energy guard counts it as the scene's own, and restarts its count of swings after a change
(loop/guards/energy_guard.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import types

from firmware_protocol.compiled import new_record
from hapsim.compiling import inlined
from hapsim.compiling.native import address_of, array_at, function_at, native, record_at
from hapsim.cordis.build_context import OF_SLIDER, knot_field, live_shares, masses_of
from hapsim.cordis.spring_energy import (
    ALONG,
    BETWEEN,
    BRISTLE,
    FROM_PLACE,
    HELD,
    SINE,
    SLIDER,
    SPRING_RECORD,
    STORED,
    TABLE,
    number_at,
    spring_energy,
    springs_at,
    stored_at,
)
from hapsim.laws import Law, Potential
from hapsim.scene import Ground, Scene
from hapsim.scene.modules import Link
from hapsim.scene.scaled_links import energy_weights

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

tank_at, _points_at, _masses_at = record_at(TANK), array_at(np.int64), array_at(np.float64)


@native(EVALUATE.return_type, *EVALUATE.args)
def evaluate(stored, position, previous, way):
    """Returns the energy of springs and masses, J, for `way` = 0; else the change of the springs' energy with the live
    values `way` bytes further on. `position` and `previous`: addresses of rows."""
    stored = stored_at(stored)
    springs, total = springs_at(stored.springs, stored.count), 0.0
    for i in range(stored.count):
        total += spring_energy(stored, springs[i], position, way)
        if way != 0:
            total -= spring_energy(stored, springs[i], position, np.uint64(0))
    count = stored.mass_count if way == 0 else 0
    points, masses = _points_at(stored.points, count), _masses_at(stored.masses, count)
    for i in range(count):
        step = number_at(position, points[i], stored.single) - number_at(previous, points[i], stored.single)
        total += masses[i] * step * step
    return total


@inlined
def affordable_share(tank, work):
    """Returns the share of a step that the tank allows. `work`: the energy that the step adds, J."""
    if work <= tank.level:
        return 1.0
    tank.slowed_ticks += 1
    return max(tank.level, 0.0) / work if work < np.inf else 0.0


@inlined
def smooth(s):
    """Returns the share of a ramp's way, and the weight of a fade, at s of its time: 3 s² - 2 s³."""
    return s * s * (3.0 - 2.0 * s)


@inlined
def remaining_ramp(share):
    """Returns the remaining time 1 - s of a ramp after this share of its way, `smooth(s)`."""
    return 0.5 + math.sin(math.asin(1.0 - 2.0 * share) / 3.0)


@inlined
def spend(tank, work):
    """Takes the energy that a change added in this sample from the tank; ignores NaN and infinity."""
    tank.changed_ticks += 1
    if abs(work) < np.inf:
        tank.level = min(tank.capacity, tank.level - work)
        tank.spent += work


class Tank:
    """A full tank in a TANK. `capacity_j`: J; `refill_j`: J per sample."""

    def __init__(self, record: Any, *, capacity_j: float, refill_j: float) -> None:
        record.address = self.address = address_of(record)
        record.level = record.capacity = capacity_j
        record.refill = refill_j


class Springs:
    """Springs of a program for compiled code, in a STORED."""

    def __init__(self, program: Any, scene: Scene, force_limit: float = np.inf) -> None:
        """`program`: a Program, which is not imported here: the loop would be compiled anew with every module.
        `force_limit`: N, of the hands."""
        self._program, self._scene, self._force_limit = program, scene, force_limit
        self._grounds, self._hands, self._at_proxies = scene.grounds, scene.device_points, scene.links_at_proxies
        self._weights = energy_weights(scene)
        self._kept: list[Any] = []
        values = program.parameters.values
        record = self._record = new_record(STORED)
        record.address = address_of(record)
        record.single = values.dtype == np.float32
        record.live = values.ctypes.data, values.ctypes.data + values.nbytes

    def _take(self, springs: list[tuple[Any, ...]]) -> None:
        self._record.springs, self._record.count = self._keep(springs, SPRING_RECORD), len(springs)

    def _keep(self, values: Any, dtype: Any = None) -> int:
        """Returns the address of constants. `dtype` [default: the scene's precision]."""
        self._kept.append(np.atleast_1d(np.asarray(values, dtype or self._program.rows.dtype)))
        return address_of(self._kept[-1])

    def _live(self, name: str, field: str) -> int:
        """Returns the address of a module's live value, or of a constant."""
        place = self._program.places.get((name, field))
        if place is None:
            return self._keep(getattr(self._scene.modules[name], field))
        return address_of(self._program.parameters.values[place : place + 1])

    def _remembered(self, name: str) -> dict[str, int]:
        """Returns the addresses of a module's memory, by the names of its columns."""
        memories = [part.memory for part in self._program.parts if part.memory and name in part.memory.modules]
        return {
            of: address_of(column[one.modules.index(name) :]) for one in memories for of, column in one.columns.items()
        }

    def _weight(self, module: str) -> float:
        """Returns the weight of the energy of a module that can move."""
        return self._weights.get(module, 1.0)

    def _of_link(self, name: str, link: Link) -> Iterator[tuple[Any, ...]]:
        points = [self._scene.coordinates_of(end)[0] for end in link.between]
        fields: dict[str, Any] = {
            "ends": [self._program.numbers[point] for point in points],
            "at": [self._live(point, "position") if point in self._grounds else 0 for point in points],
            "most": self._force_limit if any(point in self._hands for point in points) else np.inf,
            "ratio": link.second_scale[0],
            "weight": self._weight(_nodes(self._scene, link)[0]),
        }
        law = link.table() or (link.law() if name in self._at_proxies else None)
        for one in link.potentials if law is None else ():
            yield _spring(**(fields | self._potential(name, link, one)))
        if law is not None:
            yield _spring(**(fields | self._table(name, law)))
        if slider := link.slider():
            more = {"kind": SLIDER, "side": self._remembered(name)["anchor"], "reach": link.law().reach}
            yield _spring(**(fields | self._table(name, slider, OF_SLIDER) | more))

    def _table(self, name: str, law: Law, over: str = "") -> dict[str, Any]:
        keys = [knot_field(over + what, name, 0, len(law.knots)) for what in ("edge", "tension")]
        shape = [self._live(*key) for key in [*keys, *((name, over + of) for of in ("below", "beyond", "period"))]]
        edges = {end: shape[0] + self._program.rows.itemsize * knot for end, knot in law.contact_edges.items()}
        return {"kind": TABLE, "shape": shape, "knots": len(law.knots), **edges, **self._stretch(name, BETWEEN)}

    def _stretch(self, name: str, measured: int) -> dict[str, Any]:
        """Returns how a link's distance is measured in the plane, by what it remembers of x and y; {} on a line."""
        if name not in self._scene.plane_links:
            return {}
        memory = self._remembered(name)
        return {"measured": measured, "place": [memory["x"], memory["y"]]}

    def _held(self, name: str, link: Any) -> dict[str, Any]:
        shape = [
            self._keep(link.rests),
            *(self._live(name, of) for of in ("pitch", "depth", "dead_zone", "hold_until")),
        ]
        ends = {"stiffness": self._live(name, "stop"), "force": self._keep(link.holding)}
        return {"kind": HELD, "shape": shape, "knots": len(link.rests), "side": self._remembered(name)["place"], **ends}

    def _potential(self, name: str, link: Link, one: Potential) -> dict[str, Any]:
        if one.holds:
            return self._held(name, link)
        memory, zeros = self._remembered(name), self._keep([0.0, 0.0])
        field, share = next(each for each in one.stiffness if getattr(link, each[0]) is not None)
        if one.pitch:
            return {"kind": SINE, "shape": [self._live(name, one.pitch), self._live(name, field), 0, 0, 0]}
        fields: dict[str, Any] = {"stiffness": self._live(name, field), "share": share}
        if one.stretch == "bristle":
            fields |= {"ends": [0, 0], "at": [memory["bent"], zeros]}
        elif one.stretch == "level":
            fields |= self._stretch(name, ALONG) | {"offset": memory["level"]}
        elif one.stretch == "anchor":
            fields |= self._stretch(name, FROM_PLACE) or {"offset": memory["anchor"]}
        elif rest := link.law().rest:
            fields |= self._stretch(name, BETWEEN) | {"offset": self._keep(rest)}
        elif name in self._scene.plane_links:
            fields |= {"measured": FROM_PLACE, "place": [zeros, zeros]}
        if one.pushes:
            fields |= {"side": self._keep(1.0), "low": zeros}
        if one.slides_at:
            fields |= {"kind": BRISTLE, "force": self._live(name, one.slides_at)}
        fields |= {key: memory[of] for key, of in (("side", one.side), ("press", one.press)) if of}
        if one.width:
            fields["free"] = 0.5 * getattr(link, one.width)
        return fields | ({"reach": reach} if one.reach and (reach := getattr(link, one.reach)) is not None else {})


class StoredEnergy(Springs):
    """The input for computing a program's energy; its address goes into the program's PARAMETERS."""

    def __init__(self, program: Any, scene: Scene, tank: Any, force_limit: float) -> None:
        """`tank`: a TANK; the rest as of `Springs`."""
        super().__init__(program, scene, force_limit)
        connected, record = _connected(scene), self._record
        self._take([*self._links(connected), *self._points(connected), *self._structures(connected)])
        masses = [(name, mass) for name, mass in masses_of(scene) if _module(scene, name) in connected]
        record.evaluate, record.tank = evaluate.address(), tank.address
        record.points = self._keep([program.numbers[name] for name, _ in masses], np.int64)
        weighted = [self._weight(_module(scene, name)) * mass for name, mass in masses]
        record.masses = self._keep([0.5 * mass * scene.step_rate**2 for mass in weighted], np.float64)
        record.mass_count = len(masses)
        program.record.parameters.stored = record.address

    def _links(self, connected: frozenset[str]) -> Iterator[tuple[Any, ...]]:
        for name, link in (self._scene.links | self._scene.plane_links).items():
            if connected & {*_nodes(self._scene, link)}:
                yield from self._of_link(name, link)

    def _points(self, connected: frozenset[str]) -> Iterator[tuple[Any, ...]]:
        for name, point in self._scene.material_points.items():
            if name in connected and point.held_by() is not None:
                at = [0, self._live(name, "rest")]
                ends = [self._program.numbers[name], 0]
                stiffness = self._live(name, "stiffness")
                yield _spring(ends=ends, at=at, stiffness=stiffness, weight=self._weight(name))

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
                        own = {"stiffness": stiffness, "share": share, "weight": self._weight(name)}
                        yield _spring(ends=ends, at=at, **own)


_SPRING_DEFAULTS = dict.fromkeys(SPRING_RECORD.names or (), 0) | {
    **{"share": 1.0, "ratio": 1.0, "weight": 1.0, "most": np.inf, "reach": np.inf, "shape": (0,) * 5, "place": (0, 0)}
}


def _spring(**fields: Any) -> tuple[Any, ...]:
    """Returns the fields of a SPRING_RECORD, in its order."""
    return tuple((_SPRING_DEFAULTS | fields).values())


def _module(scene: Scene, point: str) -> str:
    return point if point in scene.modules else point.partition(".")[0]


def _nodes(scene: Scene, link: Link) -> list[str]:
    """Returns the movable modules at a link's ends; a structure counts as one."""
    names = [_module(scene, end) for end in link.between]
    return [name for name in names if not isinstance(scene.modules[name], Ground)]


def _connected(scene: Scene) -> frozenset[str]:
    """Returns the modules that a chain of links connects to a hand."""
    found = {_module(scene, point) for point in scene.device_points}
    pairs = [_nodes(scene, link) for link in (scene.links | scene.plane_links).values()]
    while more := {name for pair in pairs if found & {*pair} for name in pair} - found:
        found |= more
    return frozenset(found)
