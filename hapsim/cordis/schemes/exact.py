"""The exact solution of the inner linear system (`inner.py`), with the force from outside held from n to n + 1.

    M x'' + B x' + K x = f[n]      for n T <= t < (n + 1) T

Where one change of coordinates makes K and B diagonal at once, each of them a motion by itself, in O(n) for each point
that something from outside holds (`exact_modes.py`); otherwise by the matrix exponential as it is (`exact_dense.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.schemes.exact_dense import dense_part
from hapsim.cordis.schemes.exact_modes import modes_of, modes_part
from hapsim.cordis.schemes.inner import inner_system, inside, outer_parts, require_finite
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.errors import UsageError
from hapsim.scene import Scene

MOST_MODES = 4000  # whose shapes take some 15 s to be worked out


def _parts(scene: Scene, frame: Frame, taken: Sequence[Taken], rows: Column) -> tuple[Any, ...]:
    inner = inner_system(scene, frame, rows)
    parts = outer_parts(frame, taken)
    if inner is None:
        return parts
    if inner.point.size > MOST_MODES:
        raise UsageError(
            f"scheme: exact is for {MOST_MODES} masses at most, and this scene moves {inner.point.size}: take "
            "midpoint, which is stable whatever the stiffness too"
        )
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        root = 1.0 / np.sqrt(inner.mass)
        scale = root / frame.rate
        require_finite(scale, inner.links.stiffness * scale.max() ** 2, inner.links.damping * scale.max() ** 2)
    modes = modes_of(inner, frame)
    return (*parts, dense_part(inner, frame) if modes is None else modes_part(inner, modes, frame))


EXACT = Scheme(_parts, inside)
