"""Building a program: the batch of each module type, and the scheme that chooses the batches."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hapsim.compiling.native import NativeFunction
from hapsim.cordis.dispatch import Batch, Column, TickState
from hapsim.scene import Scene
from hapsim.scene.modules import Link, Module
from hapsim.scene.quantity import expectation_of


class BuildContext(NamedTuple):
    """The input for building all parts of a program.

    Attributes:
        number: of each point, by its name in links.
        rate: Hz, of the ticks.
        real: type of positions, forces and all numbers computed with them.
        loaded: numbers of the points that a link holds.
        state: all points at the first sample. Its rows of positions take turns from then on.
        pick_up_values: (C,) of the last step.
    """

    number: Mapping[str, int]
    rate: float
    real: DTypeLike
    loaded: frozenset[int]
    state: TickState
    pick_up_values: NDArray[np.float64]

    def column(self, values: Any) -> Column:
        """Returns values in the scene's precision."""
        return np.asarray(values, np.float64).astype(self.real)

    def mobility(self, mass: Any) -> Column:
        """Returns T²/m in m/N for masses in kg."""
        return self.column(1.0 / (np.asarray(mass, np.float64) * self.rate * self.rate))


Layout = Callable[[Any], tuple[Sequence[int], int]]
"""Function that returns the indices of a structure's points in its piece of memory, and the size of that."""


LiveColumn = dict[tuple[str, str], float]
"""Live values in the order of memory, each by its module and its field."""


def live_values(module: Module, rate: float) -> list[float]:
    """Returns a module's live values in the order of its `live`, as a tick at `rate` Hz uses them: dampings and
    frictions, in N·s/m, over the sample period."""
    per_sample = {"damping": rate, "friction": rate}
    read_from = module.with_default
    return [float(getattr(module, read_from.get(field, field))) * per_sample.get(field, 1.0) for field in module.live]


def live_columns(modules: Mapping[str, Any], rate: float) -> list[LiveColumn]:
    """Returns the live values of modules of one type, a column for each field."""
    rows = {name: live_values(one, rate) for name, one in modules.items()}
    fields = next(iter(modules.values())).live
    return [{(name, field): row[i] for name, row in rows.items()} for i, field in enumerate(fields)]


_OF_TABLES = {"tension", "damping", "below", "beyond"}


def is_force(link: Link, field: str) -> bool:
    """Returns whether a live value of a link, by its field in a LiveColumn, is a force or a factor of one, which a gate
    multiplies. All others are places, lengths and shares."""
    if (own := type(link).model_fields.get(field)) is None:
        return field.rpartition(": ")[2].partition(" ")[0] in _OF_TABLES
    expected = expectation_of(own)
    return expected is not None and expected.unit.startswith("N") and field not in link.ungated


def knot_field(what: str, name: str, knot: int, of: int) -> tuple[str, str]:
    """Returns the key of a knot's number in a LiveColumn: "edge 2 of 5". `name`: of the link; `of`: its knots."""
    return name, f"{what} {knot} of {of}"


OF_SLIDER = "half: "
"""Prefix of the live fields of what slides along a table."""


class BatchType(NamedTuple):
    """One type of module, or one variant of a type, as a program uses it.

    Attributes:
        select: returns its modules in a scene.
        build: returns their batch in the program; it keeps the columns of `live` without a copy.
        layout: of a structure.
        name: of its modules, in the plural, for people.
        compiled_as: description of the compiled form.
        live: returns the modules' live values in columns, as a tick at a rate in Hz uses them; None: another type's.
        moves_points: its `integrate` moves points; a scheme that moves all points itself does not use it.
        line: action of links, on `HeldLinks` and a `LineQuery` (line_query.py): what they do around a hand, for a board
            that follows lines. None: no line describes them.
    """

    select: Callable[[Scene], Mapping[str, Any]]
    build: Callable[[Mapping[str, Any], Sequence[Column], BuildContext], Batch]
    layout: Layout | None = None
    name: str = ""
    compiled_as: str = ""
    live: Callable[[Mapping[str, Any], float], list[LiveColumn]] | None = live_columns
    moves_points: bool = False
    line: NativeFunction | None = None


def all_of(
    module: type[Module], where: Callable[[Any], bool] = lambda _: True, space: int = 1
) -> Callable[[Scene], Mapping[str, Any]]:
    """Returns a function that selects every module of a type for which `where` holds, in scenes with this space."""

    def select(scene: Scene) -> dict[str, Any]:
        modules = scene.modules.items() if scene.space == space else ()
        return {name: one for name, one in modules if type(one) is module and where(one)}

    return select


def live_shares(structure: Any, rate: float) -> Iterator[tuple[str | None, Any, float]]:
    """Yields a structure split by its live values: for each, its field, the structure with that field at 1 and all
    others at 0, and the number that a tick at `rate` Hz then uses. Last, for None, the share that cannot change."""
    fixed = {"bending": 0.0} if "bending" in type(structure).model_fields else {}
    for i, live in enumerate(structure.live):
        unit = structure.model_copy(update=fixed | {field: float(field == live) for field in structure.live})
        yield live, unit, live_values(unit, rate)[i]
    if fixed:
        yield None, structure.model_copy(update=dict.fromkeys(structure.live, 0.0)), 1.0


def masses_of(scene: Scene) -> Iterator[tuple[str, float]]:
    """Yields every point that the scene moves, with its mass in kg."""
    for name, point in scene.material_points.items():
        yield name, point.mass
    for name, structure in scene.structures.items():
        for place, mass in zip(structure.point_names(), structure.elements().masses, strict=True):
            yield f"{name}.{place}", mass


class PresentType(NamedTuple):
    """A type that a scene has, its modules that are in no matrix, and the columns of their live values."""

    kind: BatchType
    modules: Mapping[str, Any]
    columns: Sequence[Column]

    def build(self, context: BuildContext) -> Batch:
        """Returns their batch in CORDIS's own scheme."""
        return self.kind.build(self.modules, self.columns, context)


class Scheme(NamedTuple):
    """A way of moving masses.

    Attributes:
        parts: the program's parts, in the order in which they act.
        inside: returns the names of the modules that become matrices when the scene is compiled. They have no part of
            their own, and cannot change while the scene runs. None: a scheme without matrices.
    """

    parts: Callable[[Scene, BuildContext, Sequence[PresentType]], tuple[Batch, ...]]
    inside: Callable[[Scene], frozenset[str]] | None = None
