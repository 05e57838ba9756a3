"""What a scheme is: which of a scene's modules it works into matrices, and the parts that it makes of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.scene import Scene


class Taken(NamedTuple):
    """A kind of module that a scene has."""

    kind: Kind
    modules: Mapping[str, Any]
    """Those that are in no matrix."""
    columns: Sequence[Column]
    """Their values that may change while the scene runs."""


def nothing_inside(_scene: Scene) -> frozenset[str]:
    """Of a scheme without matrices."""
    return frozenset()


class Scheme(NamedTuple):
    """A way of moving masses."""

    parts: Callable[[Scene, Frame, Sequence[Taken], Column], tuple[Any, ...]]
    """The program's parts, in the order in which they act; grounds are no part. The column is the program's rows, at
    the first sample."""
    inside: Callable[[Scene], frozenset[str]] = nothing_inside
    """The modules, by name, that are worked into matrices when the scene is compiled: no kind of module builds a part
    of them, and nothing of them can change while the scene runs."""
