"""The masses of a structure that links hold.

A structure moves all its masses in one pass, without forces. Forces of links reach only the masses that they hold:
those are moved once more, and no other mass is asked.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.modules.mass import mobility_of
from hapsim.cordis.simd.lanes import add_to_one
from hapsim.cordis.tick_state import Column


class LoadedPoints(NamedTuple):
    """The masses of a type of structure that links hold, by number, and their T²/m in m/N; shape (P,)."""

    point: NDArray[np.uint32]
    mobility: Column


def loaded_points_of(structures: Mapping[str, Any], context: BuildContext) -> LoadedPoints:
    """Those masses of these structures that a link holds."""
    numbers = [
        (context.number[f"{name}.{place}"], one.mass) for name, one in structures.items() for place in one.point_names()
    ]
    loaded = [(number, mass) for number, mass in numbers if number in context.loaded]
    point = np.array([number for number, _ in loaded], np.uint32)
    return LoadedPoints(point, mobility_of([mass for _, mass in loaded], context))


@inlined
def push_loaded_points(loaded, state):
    """Adds to the motion of each mass that links hold what their force on it does, and uses up the force."""
    for i in range(np.uint64(loaded.point.size)):
        p = loaded.point[i]
        add_to_one(state.following, np.uint64(p), loaded.mobility[i] * state.force[p])
        state.force[p] = 0.0
