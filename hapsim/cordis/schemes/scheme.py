"""What a scheme is: which of a scene's modules it works into matrices, and the parts that it makes of the others."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene


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
    """Of a scheme without matrices."""
    return frozenset()


class Scheme(NamedTuple):
    """A way of moving masses."""

    parts: Callable[[Scene, BuildContext, Sequence[Taken]], tuple[Part, ...]]
    """The program's parts, in the order in which they act."""
    inside: Callable[[Scene], frozenset[str]] = nothing_inside
    """The modules, by name, that are worked into matrices when the scene is compiled: no type of module builds a part
    of them, and nothing of them can change while the scene runs."""
