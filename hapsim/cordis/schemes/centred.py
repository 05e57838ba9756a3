"""CORDIS's own scheme: every kind of module moves its points itself (`mass.py`, `string.py`)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.scene import Scene


def _parts(_scene: Scene, frame: Frame, taken: Sequence[Taken], _rows: Column) -> tuple[Any, ...]:
    return tuple(kind.build(modules, columns, frame) for kind, modules, columns in taken)


CORDIS = Scheme(_parts)
