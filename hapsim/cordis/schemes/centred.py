"""CORDIS's own scheme: every type of module moves its points itself (`mass.py`, `string.py`)."""

from __future__ import annotations

from collections.abc import Sequence

from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Part
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.scene import Scene


def _parts(_scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    return tuple(one.build(context) for one in taken)


CORDIS = Scheme(_parts)
