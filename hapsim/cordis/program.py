"""Scene -> Program: the numbers of the compiled tick and the actions that it calls, for the scene's own modules alone.

Points are numbered: device points first, then grounds, then material points by type, then strings and membranes. In the
plane a point is two, x and the y after it. Each structure is one piece of memory, in whole lanes, with the borders that
its stencil needs. Live values (stiffness, damping, rest positions) share one array; the parts hold their columns of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling.native import Behind, NativeFunction, address_of
from hapsim.cordis.build_context import BatchType, BuildContext, LiveColumn, PresentType, is_force
from hapsim.cordis.dispatch import Batch, Column, TickState, calls_of
from hapsim.cordis.line_query import held_links, line_query
from hapsim.cordis.modules import (
    held_detents,
    linear_links,
    membrane,
    nonlinear_links,
    pick_ups,
    plane_links,
    plane_surfaces,
    points,
    proxy,
    string,
    table_links,
)
from hapsim.cordis.parameters import FADE_S, GateNumbers, Gates, LiveValues, set_gates
from hapsim.cordis.schemes import SCHEMES, without_matrices
from hapsim.cordis.simd import aligned, padded
from hapsim.cordis.tick import PROGRAM
from hapsim.errors import UsageError
from hapsim.scene import Scene
from hapsim.scene.issue import one_of
from hapsim.scene.words import inverted_mask

_FILES = (
    *(points, string, membrane, linear_links, table_links, nonlinear_links, held_detents, proxy, pick_ups),
    *(plane_links, plane_surfaces),
)
PART_TYPES = tuple(kind for file in _FILES for kind in vars(file).values() if isinstance(kind, BatchType))
"""Types of module that a program can have, in the order in which they act: by file, then as defined there."""

_REAL: dict[str, Any] = {"double": np.float64, "single": np.float32}


class Program:
    """A scene in memory, ready for ticks: the state of N points, and the parts that move them."""

    def __init__(
        self, scene: Scene, rows: Column, context: BuildContext, values: Column, parts: tuple[Batch, ...]
    ) -> None:
        state, self.pick_up_values = context.state, context.pick_up_values
        self.rows = rows
        """(2, N) positions in m: of this sample and of the one before, taking turns."""
        self.force = state.force
        self.parts = parts
        self.record = new_record(PROGRAM)
        """PROGRAM, for compiled code. It holds addresses of memory that this object keeps."""
        self.parameters = LiveValues(values, self.record.parameters, gates_of(scene) if scene.gated else None)
        self.numbers = context.number
        """Number of each point, by name."""
        self._scene = scene
        self.stored: Any = None
        """StoredEnergy, where the energy is accounted for."""
        self.events: Any = None
        """Events of the loop, where outputs follow the scene."""
        self._kept: list[Any] = []
        hands = scene.device_points
        self.record.hands = len(hands)
        self.record.channel[: len(hands)] = [hands[name].channel for name in _hands(scene)]
        self.record.senses = bool(scene.sensed_links)
        self.record.single = rows.dtype == np.float32
        self.record.rows = [row.ctypes.data for row in rows]
        self.record.force = state.force.ctypes.data
        self.record.velocity = state.velocity.ctypes.data
        self.record.pick_up_values = self.pick_up_values.ctypes.data
        self._states = [Behind(_state_at(rows, turn, state.force, state.velocity)) for turn in range(2)]
        self.record.states = [one.address for one in self._states]
        for name in ("initialize", "retarget", "add_forces", "integrate"):
            self.call_all_of(name)

    @cached_property
    def places(self) -> dict[tuple[str, str], int]:
        """Index of each live value in `parameters`, by module name and field."""
        return places_of_values(self._scene)

    @property
    def memory(self) -> tuple[Any, ...]:
        """Nested arrays and records with everything that a tick changes, and some constants."""
        queries = [one.value for one in self._kept if isinstance(one, Behind)]
        parts = [(part.numbers, part.memory and part.memory.columns) for part in self.parts]
        own = self.rows, self._states[0].value, self.pick_up_values, self.record
        return *own, vars(self.parameters), parts, queries

    @property
    def address(self) -> int:
        """Address for compiled code, valid as long as this object exists."""
        return address_of(self.record)

    def call(self, name: str, actions: Iterable[tuple[NativeFunction, Any]], on: Behind | None = None) -> None:
        """Fills one of the lists of calls in PROGRAM with actions and their numbers, and compiles new actions. Call it
        before the first tick. `on`: their second argument, if it is not a TickState."""
        behind = [(act, Behind(numbers)) for act, numbers in actions]
        pairs = calls_of(behind, on or self._states[0])
        self.record[name].pairs, self.record[name].count = pairs.ctypes.data, len(pairs)
        self._kept.append((behind, pairs))

    def call_all_of(self, name: str) -> None:
        """Fills a list with the actions of this name of all parts."""
        has_gates = name == "initialize" and self.parameters.gates
        own = [(set_gates, GateNumbers(self.record.parameters))] if has_gates else []
        parts = [(getattr(part, name), part.numbers) for part in self.parts if getattr(part, name) is not None]
        self.call(name, [*own, *parts])

    def answer_queries(self, types: Iterable[BatchType]) -> None:
        """Prepares the links of the hands for the lines of `law: board`. `types`: of the parts, in their order."""
        hands = int(self.record.hands)
        query = line_query(self.rows, hands)
        behind, pairs = Behind(query), zip(types, self.parts, strict=True)
        links = [(kind.line, held_links(part.numbers, hands)) for kind, part in pairs if kind.line is not None]
        self.call("line", [(line, held) for line, held in links if held.held.size], behind)
        self.record.query = [behind.address, *(one.ctypes.data for one in query[2:])]
        self._kept.append(behind)


def compile_scene(scene: Scene, values: Column | None = None) -> Program:
    """Returns the program of `scene` at its initial state. `values`: the array of `parameter_values`, read at every
    tick, so that the caller may change it. Raises UsageError for numbers beyond the scene's scheme."""
    require_gates(scene)
    if values is None:
        values = parameter_values(scene)
    number, size, structures = _numbers(scene)
    with np.errstate(all="ignore"):  # an infinity is rejected by the scheme, or by the guard
        rows = _rows(scene, number, size, structures)
        velocity = np.zeros(len(scene.device_points))
        context = BuildContext(
            number=number,
            rate=scene.step_rate,
            real=_REAL[scene.precision],
            loaded=frozenset(number[end] for link in scene.links.values() for end in link.between),
            state=_state_at(rows, 0, np.zeros(size, _REAL[scene.precision]), velocity),
            pick_up_values=np.zeros(len(scene.sound)),
        )
        types = list(_present_types(scene, values))
        parts = SCHEMES[scene.scheme].parts(scene, context, types)
    program = Program(scene, rows, context, values, parts)
    if scene.device.law == "board":
        require_lines(scene)
        program.answer_queries(one.kind for one in types)
    return program


def require_lines(scene: Scene) -> None:
    """Raises UsageError if no lines describe what the scene does to its hands, so that a board cannot follow it."""
    where = "device.law: found board"
    for name, found, expected in (("scheme", scene.scheme, "cordis"), ("substeps", scene.substeps, 1)):
        if found != expected:
            raise UsageError(f"{where} with {name}: {found}, expected {name}: {expected}, or law: host")
    at_proxies = scene.links_at_proxies if scene.proxies else {}
    for kind in PART_TYPES:
        for name, module in kind.select(scene).items():
            is_left_out = kind.line is None or name in at_proxies
            if is_left_out and not {*scene.device_points}.isdisjoint(getattr(module, "between", ())):
                raise UsageError(
                    f"{where}, but {name} is none of the links of a hand that a board can follow ({kind.name}); join "
                    "it to a mass there, or write law: host"
                )


def require_gates(scene: Scene) -> None:
    """Raises UsageError if the scheme has a link with `when` in its matrices, which no gate reaches."""
    if inside := sorted(scene.gated.keys() & fixed_modules(scene)) if scene.gated else []:
        expected = f"expected scheme: {one_of(without_matrices())}, or a link without when"
        raise UsageError(f"{inside[0]}.when: found scheme: {scene.scheme}, which compiles it into a matrix; {expected}")


def gates_of(scene: Scene) -> Gates:
    """Returns the gates of the scene's live values."""
    links = scene.gated
    inputs = {name: one for name, one in scene.inputs.items() if name in {link.when for link in links.values()}}
    number: dict[str | None, int] = {name: i for i, name in enumerate(inputs)}
    gate_of = [
        number[link.when] if (link := links.get(name)) and is_force(link, field) else -1
        for name, field in places_of_values(scene)
    ]
    masks = {name: one.mask for name, one in inputs.items()}
    return Gates(masks, gate_of, inverted_mask(inputs.values()), FADE_S * scene.step_rate)


def parameter_values(scene: Scene) -> Column:
    """Returns the values that can change while the scene runs, shape (P,): the live columns of all types of module."""
    values = [value for *_, columns in _live(scene) for column in columns for value in column.values()]
    return np.array(values, _REAL[scene.precision])


def places_of_values(scene: Scene) -> dict[tuple[str, str], int]:
    """Returns the index of each live value in `parameter_values`, by module name and field."""
    keys = (key for *_, columns in _live(scene) for column in columns for key in column)
    return {key: i for i, key in enumerate(keys)}


def _live(scene: Scene) -> Iterator[tuple[BatchType, Mapping[str, Any], list[LiveColumn]]]:
    """Yields the types that the scene has, each with its live columns and its modules, except those that are in the
    scheme's matrices."""
    fixed = fixed_modules(scene)
    for kind in PART_TYPES:
        modules = {name: one for name, one in kind.select(scene).items() if name not in fixed}
        if modules:
            yield kind, modules, [] if kind.live is None else kind.live(modules, scene.step_rate)


def fixed_modules(scene: Scene) -> frozenset[str]:
    """Returns the modules that cannot change while the scene runs, because its scheme has them in a matrix."""
    inside = SCHEMES[scene.scheme].inside
    return frozenset() if inside is None else inside(scene)


def positions_of(program: Program) -> tuple[Column, Column]:
    """Returns the points' positions at this sample and at the one before, (N,) m each; the program's own, not copies.
    The earlier position of a hand is valid only within a tick."""
    turn = int(program.record.turn)
    return program.rows[turn], program.rows[turn - 1]


def numbers_of(scene: Scene) -> dict[str, int]:
    """Returns the index of each point in a program's arrays, by name."""
    return dict(_numbers(scene)[0])


def _present_types(scene: Scene, values: Column) -> Iterator[PresentType]:
    """Yields the scene's types with their columns of the parameters."""
    begin = 0
    for kind, modules, columns in _live(scene):
        ends = begin + np.cumsum([0, *map(len, columns)])
        yield PresentType(kind, modules, [values[low:high] for low, high in pairwise(ends)])
        begin = int(ends[-1])


def _hands(scene: Scene) -> list[str]:
    """Returns the device points in the order of their numbers: by channel, x and y of each hand together."""
    hands = scene.device_points
    return sorted(hands, key=lambda name: min(scene.hand_of(hands[name].channel)))


def _numbers(scene: Scene) -> tuple[dict[str, int], int, dict[str, slice]]:
    """Returns the number of each point, the total with borders and fill, and the slice of each structure."""
    names = [*_hands(scene), *scene.grounds, *scene.material_points]
    number = {name: i for i, name in enumerate(names)}
    points = len(names) if not scene.structures else padded(len(names))
    structures: dict[str, slice] = {}
    having = [(kind.layout, kind.select(scene)) for kind in PART_TYPES if kind.layout is not None]
    for layout, name, structure in ((layout, *item) for layout, modules in having for item in modules.items()):
        places, size = layout(structure)
        number |= {f"{name}.{place}": points + i for place, i in zip(structure.point_names(), places, strict=True)}
        structures[name] = slice(points, points + size)
        points += size
    return number, points, structures


def _rows(scene: Scene, number: Mapping[str, int], size: int, structures: Mapping[str, slice]) -> Column:
    """Returns the positions at the first sample and at the one before, (2, N) m."""
    rows = np.zeros((2, size), np.float64)
    modules: Mapping[str, Any] = scene.structures
    for name, structure in modules.items():
        rows[:, structures[name]] = structure.position
        rows[:, [number[f"{name}.{place}"] for place in structure.point_names()]] = structure.initial_positions()
    for name, ground in scene.grounds.items():
        rows[:, number[name]] = ground.position
    for name, point in scene.material_points.items():
        position, velocity = point.start()
        rows[0, number[name]] = position
        rows[1, number[name]] = position - velocity / scene.step_rate
    return aligned(rows, _REAL[scene.precision])


def _state_at(rows: Column, turn: int, force: Column, velocity: Any) -> TickState:
    """Returns the program's state when row `turn` has the positions of this sample."""
    return TickState(rows[turn], rows[1 - turn], force, velocity)
