"""Scene -> Program: the arrays that the compiled tick works on, and nothing that the scene does not have.

Points are numbered: device points first (the exchange writes them), then grounds, then masses (which stand together, so
that they advance in one pass), then the points of strings and membranes, each in one piece with the borders that its
stencil needs. What can be changed while the scene runs (stiffness, damping, rest positions) stands together in one
array, of which the parts hold their columns: `parameter_values` says what stands where.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.cordis.device_point import DevicePoints, device_points
from hapsim.cordis.ground import GROUND, Grounds
from hapsim.cordis.kind import Column, Frame, Kind, Layout
from hapsim.cordis.kinds import KINDS
from hapsim.scene import Scene

_REAL = {"double": np.float64, "single": np.float32}


class Program(NamedTuple):
    """A scene as the tick sees it: the state of N points, and the parts that move them."""

    rows: Column
    """(3, N) positions in m: of this sample, the one before and the next, taking turns."""
    turn: NDArray[np.uint64]
    """(1,) which row is this sample's."""
    force: Column
    """(N,) N"""
    loose: int
    """How many points, the first, have their force set to zero with every tick; the others' parts see to theirs."""
    devices: DevicePoints
    grounds: Grounds | None
    parts: tuple[Any, ...]
    """One for each kind of module that the scene has: see `acting`."""


def compile_scene(scene: Scene, values: Column | None = None) -> Program:
    """The program of `scene`, at its initial state.

    `values`: what `parameter_values` gives, kept and read at every tick, so that who holds it may change it.
    """
    frame, loose, begins = _frame(scene)
    if values is None:
        values = parameter_values(scene)
    built = [(kind, kind.build(modules, columns, frame)) for kind, modules, columns in _taken(scene, values)]
    rows = _rows(scene, frame, loose, begins)
    return Program(
        rows=rows,
        turn=np.zeros(1, np.uint64),
        force=np.zeros(rows.shape[1], frame.real),
        loose=loose,
        devices=device_points([point.channel for point in scene.device_points.values()]),
        grounds=next((part for kind, part in built if kind is GROUND), None),
        parts=tuple(part for kind, part in built if kind is not GROUND),
    )


def parameter_values(scene: Scene) -> Column:
    """What can be changed while the scene runs, shape (P,): the live columns of every kind of module, in turn."""
    columns = [
        column for kind in KINDS if (modules := kind.select(scene)) for column in _columns(kind, modules, scene.rate)
    ]
    with np.errstate(over="ignore"):
        return np.array([value for column in columns for value in column], np.float64).astype(real_of(scene))


def real_of(scene: Scene) -> Any:
    """The kind of number that a scene is worked out in."""
    return _REAL[scene.precision]


def positions_of(program: Program) -> tuple[Column, Column]:
    """(N,) where the points are, and where they were a sample before, in m; the program's own, not copies."""
    now = int(program.turn[0])
    return program.rows[now], program.rows[now - 1]


def numbers_of(scene: Scene) -> dict[str, int]:
    """Where each point stands in a program's arrays, by its name."""
    return dict(_frame(scene)[0].number)


def _columns(kind: Kind, modules: Any, rate: float) -> list[list[float]]:
    return kind.live(list(modules.values()), rate)


def _taken(scene: Scene, values: Column) -> Iterator[tuple[Kind, Any, list[Column]]]:
    """The kinds that the scene has, with their modules and their columns of the parameters."""
    begin = 0
    for kind in KINDS:
        modules = kind.select(scene)
        if not modules:
            continue
        columns = []
        for column in _columns(kind, modules, scene.rate):
            columns.append(values[begin : begin + len(column)])
            begin += len(column)
        yield kind, modules, columns


def _structures(scene: Scene) -> Iterator[tuple[Layout, str, Any]]:
    """The structures, in the order in which they stand in memory."""
    for kind in KINDS:
        if kind.layout is not None:
            for name, structure in kind.select(scene).items():
                yield kind.layout, name, structure


def _frame(scene: Scene) -> tuple[Frame, int, list[float]]:
    """The numbers of all points, how many stand before the first structure's, and where the structures begin, in m."""
    names = [*scene.device_points, *scene.grounds, *scene.masses]
    number = {name: i for i, name in enumerate(names)}
    loose = points = len(names)
    begins: list[float] = []
    for layout, name, structure in _structures(scene):
        numbers, size = layout(structure)
        begins += [structure.position] * size
        for place, i, position in zip(structure.places(), numbers, structure.begins(), strict=True):
            number[f"{name}.{place}"] = points + i
            begins[points + i - loose] = position
        points += size
    ends = {end for link in scene.links.values() for end in link.between}
    return Frame(number, scene.rate, real_of(scene), frozenset(number[end] for end in ends)), loose, begins


def _rows(scene: Scene, frame: Frame, loose: int, begins: list[float]) -> Column:
    """The positions at the first sample, and where the points were before it."""
    rows = np.zeros((3, loose + len(begins)), np.float64)
    rows[:, loose:] = begins
    for name, ground in scene.grounds.items():
        rows[:, frame.number[name]] = ground.position
    for name, mass in scene.masses.items():
        rows[0, frame.number[name]] = mass.position
        rows[2, frame.number[name]] = mass.position - mass.velocity / scene.rate
    with np.errstate(over="ignore"):  # the guard sees what comes of an infinity
        return rows.astype(frame.real)
