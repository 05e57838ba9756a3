"""Scene -> Program: the arrays that the compiled tick works on, and nothing that the scene does not have.

Points are numbered: device points first (the exchange writes them), then grounds, then masses and behind them cells
(which stand together, so that they advance in one pass), then the points of strings and membranes, each in one piece
with the borders that its stencil needs, in whole lanes. What can be changed while the scene runs (stiffness, damping,
rest positions) stands together in one array, of which the parts hold their columns: `parameter_values` says what
stands where.
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
from hapsim.cordis.lanes import aligned, padded
from hapsim.cordis.schemes import SCHEMES
from hapsim.cordis.schemes.scheme import Taken
from hapsim.scene import Scene

_REAL = {"double": np.float64, "single": np.float32}


class Program(NamedTuple):
    """A scene as the tick sees it: the state of N points, and the parts that move them."""

    rows: Column
    """(3, N) positions in m: of this sample, the next and the one before, taking turns."""
    turn: NDArray[np.uint64] | None
    """(1,) which row is this sample's; None where the scene itself moves nothing: then it is always the first."""
    force: Column | None
    """(N,) N, added up during a tick; who uses a force sets it to zero. Nobody uses a ground's. None where there is but
    the force of one link on the only hand: then each tick works it out in registers (`moment.py`)."""
    devices: DevicePoints
    grounds: Grounds | None
    parts: tuple[Any, ...]
    """One for each kind of module that the scene has: see `acting`."""


def compile_scene(scene: Scene, values: Column | None = None, channels: int | None = None) -> Program:
    """The program of `scene`, at its initial state.

    `values`: what `parameter_values` gives, kept and read at every tick, so that who holds it may change it.
    `channels`: how many the device has, and positions and forces stand for; left out: as many as the scene needs.
    """
    channels = scene.channels if channels is None else channels
    frame, loose, begins = _frame(scene, channels)
    if values is None:
        values = parameter_values(scene)
    taken = list(_taken(scene, values))
    grounds = [one.kind.build(one.modules, one.columns, frame) for one in taken if one.kind is GROUND]
    rows = _rows(scene, frame, loose, begins)
    return Program(
        rows=rows,
        turn=np.zeros(1, np.uint64) if len(frame.number) > len(frame.grounds) + len(scene.device_points) else None,
        force=None if frame.hand_on_ground else np.zeros(rows.shape[1], frame.real),
        devices=device_points(sorted(point.channel for point in scene.device_points.values()), channels),
        grounds=grounds[0] if grounds else None,
        parts=SCHEMES[scene.scheme].parts(scene, frame, [one for one in taken if one.kind is not GROUND], rows),
    )


def parameter_values(scene: Scene) -> Column:
    """What can be changed while the scene runs, shape (P,): the live columns of every kind of module, in turn."""
    columns = [column for kind, modules in _by_kind(scene) for column in _columns(kind, modules, scene.rate)]
    with np.errstate(over="ignore"):
        return np.array([value for column in columns for value in column], np.float64).astype(real_of(scene))


def fixed_modules(scene: Scene) -> frozenset[str]:
    """The modules of which nothing can change while the scene runs, because its scheme has them in a matrix."""
    return SCHEMES[scene.scheme].inside(scene)


def real_of(scene: Scene) -> Any:
    """The kind of number that a scene is worked out in."""
    return _REAL[scene.precision]


def positions_of(program: Program) -> tuple[Column, Column]:
    """(N,) where the points are, and where they were a sample before, in m; the program's own, not copies.

    Of hands, the second is of use to the tick alone.
    """
    now = 0 if program.turn is None else int(program.turn[0])
    return program.rows[now], program.rows[now - 1]


def numbers_of(scene: Scene) -> dict[str, int]:
    """Where each point stands in a program's arrays, by its name."""
    return dict(_frame(scene, scene.channels)[0].number)


def _columns(kind: Kind, modules: Any, rate: float) -> list[list[float]]:
    return kind.live(list(modules.values()), rate)


def _by_kind(scene: Scene) -> Iterator[tuple[Kind, Any]]:
    """The kinds that the scene has, each with its modules, without those that are in its scheme's matrices."""
    fixed = fixed_modules(scene)
    for kind in KINDS:
        modules = {name: one for name, one in kind.select(scene).items() if name not in fixed}
        if modules:
            yield kind, modules


def _taken(scene: Scene, values: Column) -> Iterator[Taken]:
    """The same with their columns of the parameters."""
    begin = 0
    for kind, modules in _by_kind(scene):
        columns = []
        for column in _columns(kind, modules, scene.rate):
            columns.append(values[begin : begin + len(column)])
            begin += len(column)
        yield Taken(kind, modules, columns)


def _structures(scene: Scene) -> Iterator[tuple[Layout, str, Any]]:
    """The structures, in the order in which they stand in memory."""
    for kind in KINDS:
        if kind.layout is not None:
            for name, structure in kind.select(scene).items():
                yield kind.layout, name, structure


def _frame(scene: Scene, channels: int) -> tuple[Frame, int, list[float]]:
    """The numbers of all points, how many stand before the first structure's, and where the structures begin, in m."""
    hands = sorted(scene.device_points, key=lambda name: scene.device_points[name].channel)
    names = [*hands, *scene.grounds, *scene.masses, *scene.cells]
    number = {name: i for i, name in enumerate(names)}
    loose = len(names) if not scene.structures else padded(len(names))
    points = loose
    begins: list[float] = []
    for layout, name, structure in _structures(scene):
        numbers, size = layout(structure)
        begins += [structure.position] * size
        for place, i, position in zip(structure.places(), numbers, structure.begins(), strict=True):
            number[f"{name}.{place}"] = points + i
            begins[points + i - loose] = position
        points += size
    ends = {end for link in scene.links.values() for end in link.between}
    touched, grounds = (frozenset(number[name] for name in names) for names in (ends, scene.grounds))
    on_ground = channels == 1 and _is_hand_on_ground(scene)
    return Frame(number, scene.rate, real_of(scene), touched, grounds, on_ground, points), loose, begins


def _is_hand_on_ground(scene: Scene) -> bool:
    """Whether the scene is one hand, grounds, and one link, from the hand to the first of them."""
    first_two = (*scene.device_points, *scene.grounds)[:2]
    nothing_else = len(scene.modules) == len(scene.device_points) + len(scene.grounds) + len(scene.links)
    links = [link.between for link in scene.links.values()]
    return nothing_else and len(scene.device_points) == 1 and links == [first_two]


def _rows(scene: Scene, frame: Frame, loose: int, begins: list[float]) -> Column:
    """The positions at the first sample, and where the points were before it."""
    rows = np.zeros((3, loose + len(begins)), np.float64)
    rows[:, loose:] = begins
    for name, ground in scene.grounds.items():
        rows[:, frame.number[name]] = ground.position
    starts = {name: (mass.position, mass.velocity) for name, mass in scene.masses.items()}
    starts |= {name: (cell.start, cell.velocity) for name, cell in scene.cells.items()}
    for name, (position, velocity) in starts.items():
        rows[0, frame.number[name]] = position
        rows[2, frame.number[name]] = position - velocity / scene.rate
    with np.errstate(over="ignore"):  # the guard sees what comes of an infinity
        return aligned(rows, frame.real)
