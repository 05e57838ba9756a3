"""How the modules of one type become a part of a program, and how a scheme chooses the parts."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from hapsim.cordis.dispatch import Column, Part, TickState
from hapsim.scene import Scene
from hapsim.scene.modules import Module


class BuildContext(NamedTuple):
    """What all parts of a program are built in."""

    number: Mapping[str, int]
    """Of each point, by the name that links call it."""
    rate: float
    """Hz"""
    real: DTypeLike
    """Of positions, forces and everything that is worked out with them."""
    loaded: frozenset[int]
    """Numbers of the points that a link holds."""
    state: TickState
    """All points at the first sample. Its rows of positions take turns from then on; `force` and `velocity` stay."""

    def column(self, values: Any) -> Column:
        """Values in the scene's precision."""
        return np.asarray(values, np.float64).astype(self.real)

    def mobility(self, mass: Any) -> Column:
        """T²/m in m/N of masses in kg."""
        return self.column(1.0 / (np.asarray(mass, np.float64) * self.rate * self.rate))


Layout = Callable[[Any], tuple[Sequence[int], int]]
"""Where a structure's points stand in the piece of memory that it needs, and how many numbers that holds."""


class PartType(NamedTuple):
    """One type of module, or one variant of a type: all that a program has to know of it."""

    select: Callable[[Scene], Mapping[str, Any]]
    """Its modules in a scene."""
    build: Callable[[Mapping[str, Any], Sequence[Column], BuildContext], Part]
    """Their part of the program; the columns are those of `live_values`, kept, not copied."""
    layout: Layout | None = None
    """Of a structure."""
    name: str = ""
    """What people call its modules, in the plural."""
    compiled_as: str = ""
    """What they become, in words."""
    is_live: bool = True
    """It has the modules' live values; no other type has them too."""
    moves_points: bool = False
    """Its `integrate` moves points: a scheme that moves all points itself has no use for it."""
    memoryless: bool = False
    """Its links remember nothing, so that they can be asked for their forces between samples too."""
    in_a_matrix: bool = False
    """Its links are a spring and a backward damper and nothing else: their `stiffness` and `damping`, or 0."""


def all_of(module: type[Module], where: Callable[[Any], bool] = lambda _: True) -> Callable[[Scene], Mapping[str, Any]]:
    """Selects every module of a type for which `where` holds."""
    return lambda scene: {name: one for name, one in scene.modules.items() if type(one) is module and where(one)}


_PER_SAMPLE = ("damping", "friction")


def live_values(module: Module, rate: float) -> list[float]:
    """A module's values that may change while the scene runs, in the order of its `live`, as a tick at `rate` Hz works
    with them: dampings and frictions, in N·s/m, over the sample period."""
    read_from = {"static": "break_away"}  # with its default
    values = [float(getattr(module, read_from.get(field, field))) for field in module.live]
    return [value * rate if field in _PER_SAMPLE else value for field, value in zip(module.live, values, strict=True)]


def live_shares(structure: Any, rate: float) -> Iterator[tuple[str | None, Any, float]]:
    """A structure taken apart by what its live values do: for each its field, the structure with that field at 1 and
    all else at 0, and what a tick at `rate` Hz works with then. Last, for None, what cannot change, by itself."""
    fixed = {"bending": 0.0} if "bending" in type(structure).model_fields else {}
    for i, live in enumerate(structure.live):
        unit = structure.model_copy(update=fixed | {field: float(field == live) for field in structure.live})
        yield live, unit, live_values(unit, rate)[i]
    if fixed:
        yield None, structure.model_copy(update=dict.fromkeys(structure.live, 0.0)), 1.0


def masses_of(scene: Scene) -> Iterator[tuple[str, float]]:
    """Every point that the scene moves, with its mass in kg."""
    for name, point in scene.material_points.items():
        yield name, point.mass
    for name, structure in scene.structures.items():
        for place, mass in zip(structure.point_names(), structure.elements().masses, strict=True):
            yield f"{name}.{place}", mass


class Taken(NamedTuple):
    """A type of module that a scene has."""

    kind: PartType
    modules: Mapping[str, Any]
    """Those that are in no matrix."""
    columns: Sequence[Column]
    """Their values that may change while the scene runs."""

    def build(self, context: BuildContext) -> Part:
        """Their part of the program, as CORDIS's own scheme has it."""
        return self.kind.build(self.modules, self.columns, context)


def nothing_inside(_scene: Scene) -> frozenset[str]:
    """The modules in the matrices of a scheme that has none."""
    return frozenset()


class Scheme(NamedTuple):
    """A way of moving masses."""

    parts: Callable[[Scene, BuildContext, Sequence[Taken]], tuple[Part, ...]]
    """The program's parts, in the order in which they act."""
    inside: Callable[[Scene], frozenset[str]] = nothing_inside
    """The modules, by name, that are worked into matrices when the scene is compiled: no type of module builds a part
    of them, and nothing of them can change while the scene runs."""
