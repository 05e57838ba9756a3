"""How the modules of one type become a part of a program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike

from hapsim.cordis.dispatch import Part
from hapsim.cordis.tick_state import Column, TickState
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

    def column(self, values: Sequence[float]) -> Column:
        """Values in the scene's precision."""
        return np.array(values, np.float64).astype(self.real)


def _nothing_live(_modules: Sequence[Any], _rate: float) -> list[list[float]]:
    return []


Layout = Callable[[Any], tuple[Sequence[int], int]]
"""Where a structure's points stand in the piece of memory that it needs, and how many numbers that holds."""


class PartType(NamedTuple):
    """One type of module, or one variant of a type: all that a program has to know of it."""

    select: Callable[[Scene], Mapping[str, Any]]
    """Its modules in a scene."""
    build: Callable[[Mapping[str, Any], Sequence[Column], BuildContext], Part]
    """Their part of the program; the columns are those of `live`, kept, not copied."""
    live: Callable[[Sequence[Any], float], list[list[float]]] = _nothing_live
    """Their values that may change while the scene runs, at a rate in Hz: columns with one value per module."""
    layout: Layout | None = None
    """Of a structure."""
    name: str = ""
    """What people call its modules, in the plural."""
    compiled_as: str = ""
    """What they become, in words."""
    moves_points: bool = False
    """Its `integrate` moves points: a scheme that moves all points itself has no use for it."""
    memoryless: bool = False
    """Its links remember nothing, so that they can be asked for their forces between samples too."""
    in_a_matrix: Callable[[Any], tuple[float, float]] | None = None
    """Of links that are a spring and a backward damper and nothing else: their K in N/m and B in N·s/m."""


def all_of(module: type[Module]) -> Callable[[Scene], Mapping[str, Any]]:
    """Selects every module of a type."""
    return lambda scene: {name: one for name, one in scene.modules.items() if type(one) is module}
