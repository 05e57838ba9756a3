"""The exact solution of the linear subsystem (`linear_subsystem.py`), with the force from outside held from n to n + 1.

    M x'' + B x' + K x = f[n]      for n T <= t < (n + 1) T

Where one change of coordinates makes K and B diagonal at once, each of them a motion by itself, in O(n) for each point
that something from outside holds (`exact_modes.py`); otherwise by the matrix exponential as it is (`exact_dense.py`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Part
from hapsim.cordis.schemes.exact_dense import dense_part
from hapsim.cordis.schemes.exact_modes import modes_of, modes_part
from hapsim.cordis.schemes.linear_subsystem import external_parts, inside, linear_subsystem, require_finite
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.errors import UsageError
from hapsim.scene import Scene

MOST_MODES = 4000  # whose shapes take some 15 s to be worked out


def _parts(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    inner = linear_subsystem(scene, context)
    parts = external_parts(context, taken)
    if inner is None:
        return parts
    if inner.point.size > MOST_MODES:
        raise UsageError(
            f"scheme: exact is for {MOST_MODES} masses at most, and this scene moves {inner.point.size}: take "
            "midpoint, which is stable whatever the stiffness too"
        )
    scale = 1.0 / np.sqrt(inner.mass) / context.rate
    require_finite(scale, inner.links.stiffness * scale.max() ** 2, inner.links.damping * scale.max() ** 2)
    modes = modes_of(inner, context)
    return (*parts, dense_part(inner, context) if modes is None else modes_part(inner, modes, context))


EXACT = Scheme(_parts, inside)
