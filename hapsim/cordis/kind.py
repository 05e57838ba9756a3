"""How the modules of one type become a part of the program."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from hapsim.scene import Scene
from hapsim.scene.modules import Module

Column = NDArray[np.floating[Any]]


class Frame(NamedTuple):
    """What all parts of a program stand in."""

    number: Mapping[str, int]
    """Of each point, by the name that links call it."""
    rate: float
    """Hz"""
    real: DTypeLike
    """Of positions, forces and everything that is worked out with them."""
    touched: frozenset[int]
    """Numbers of the points that a link holds."""
    grounds: frozenset[int]
    """Numbers of the grounds."""
    hand_on_ground: bool
    """There is one link, from the hand on the device's only channel to the first ground, and nothing that moves: its
    ends are constants, and its force is the hand's."""
    points: int
    """How many numbers a row of positions has: borders of structures, and what fills their lanes, included."""

    def column(self, values: Sequence[float]) -> Column:
        """Values in the scene's kind of number; the guard sees what comes of an infinity."""
        with np.errstate(over="ignore"):
            return np.array(values, np.float64).astype(self.real)

    def ends(self, pairs: Sequence[tuple[str, str]]) -> NDArray[np.uint32]:
        """The numbers of the points that links join, shape (2, L)."""
        numbers = [(self.number[first], self.number[second]) for first, second in pairs]
        return np.ascontiguousarray(np.array(numbers, np.uint32).reshape(-1, 2).T)


def _none(_modules: Sequence[Any], _rate: float) -> list[list[float]]:
    return []


Layout = Callable[[Any], tuple[Sequence[int], int]]
"""Where a structure's points stand in the piece of memory that it needs, and how many numbers that holds."""


class Kind(NamedTuple):
    """One type of module, or one variant of a type."""

    select: Callable[[Scene], Mapping[str, Any]]
    """Its modules in a scene."""
    build: Callable[[Mapping[str, Any], Sequence[Column], Frame], Any]
    """Their part of the program; the columns are those of `live`, kept, not copied."""
    live: Callable[[Sequence[Any], float], list[list[float]]] = _none
    """Their values that may change while the scene runs, at a rate in Hz: columns with one value per module."""
    layout: Layout | None = None
    """Of a structure."""
    name: str = ""
    """What people call its modules, in the plural."""
    compiled_as: str = ""
    """What they become, in words."""
    forgets: bool = False
    """Its links remember nothing, so that they can be asked for their forces between samples too."""


def all_of(module: type[Module]) -> Callable[[Scene], Mapping[str, Any]]:
    """Selects every module of a type."""
    return lambda scene: {name: one for name, one in scene.modules.items() if type(one) is module}
