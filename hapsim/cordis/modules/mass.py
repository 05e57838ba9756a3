"""The mass: second-order centred scheme (Florens et al., §6, Figure 5a; CORDIS: MAS).

(m / T²) (x[n+1] - 2 x[n] + x[n-1]) = F[n]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PartType
from hapsim.cordis.dispatch import Part, fma_action
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene
from hapsim.scene.modules import MaterialPoint


class Masses(NamedTuple):
    """M masses, one type of material point after the other, from point `start` on; `mobility`: T²/m in m/N, (M,)."""

    start: np.uint64
    mobility: Column


@fma_action
def integrate(group, state):
    """Moves every mass by one sample, and uses up the force on it."""
    group, state = value_of(group), value_of(state)
    first, end = group.start, group.start + np.uint64(group.mobility.size)
    x, before, after = state.position[first:end], state.previous[first:end], state.following[first:end]
    force = state.force[first:end]
    for i in range(np.uint64(group.mobility.size)):
        after[i] = x[i] + x[i] - before[i] + group.mobility[i] * force[i]
        force[i] = 0.0


def mobility_of(mass: Sequence[float] | float, context: BuildContext) -> Column:
    """T²/m of masses in kg."""
    return np.asarray(1.0 / (np.asarray(mass, np.float64) * context.rate * context.rate), context.real)


def _select(scene: Scene) -> Mapping[str, MaterialPoint]:
    return scene.material_points


def _build(masses: Mapping[str, MaterialPoint], _columns: Sequence[Column], context: BuildContext) -> Part:
    start = np.uint64(context.number[next(iter(masses))])
    return Part(Masses(start, mobility_of([one.mass for one in masses.values()], context)), integrate=integrate)


MASS = PartType(
    _select,
    _build,
    name="masses",
    compiled_as="one pass over contiguous memory",
    moves_points=True,
)
