"""The semi-implicit (symplectic) Euler scheme, with each mass's step w = T v stored.

    w[n+1] = w[n] + (T²/m) F[n],      x[n+1] = x[n] + w[n+1]

is CORDIS's centred scheme in exact arithmetic: w[n] = x[n] - x[n-1] by the second equation, and the first is then
x[n+1] - 2 x[n] + x[n-1] = (T²/m) F[n]. In floating point, x[n] - x[n-1] has the rounding error of two positions, about
an ulp of x, and that error stays in the velocity. A stored step is rounded to an ulp of its own, and the rounding of
the position never enters it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling import fma
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext, PresentType, Scheme
from hapsim.cordis.dispatch import Batch, Column, action
from hapsim.cordis.schemes.force_expansion import expanded_forces, first_moved, mobility_of_all
from hapsim.scene import Scene


class Steps(NamedTuple):
    """The points from number `start` on: T²/m in m/N, and w in m; shape (n,)."""

    start: np.uint64
    mobility: Column
    step: Column


@action
def initialize(points, state):
    """Sets the steps from the points' positions of both samples."""
    points, state = value_of(points), value_of(state)
    for i in range(np.uint64(points.step.size)):
        points.step[i] = state.position[points.start + i] - state.previous[points.start + i]


@action
def integrate(points, state):
    """Moves every point by one sample; its previous position becomes the new one less the step."""
    points, state = value_of(points), value_of(state)
    start = points.start
    _advance(points.mobility, points.step, state.position[start:], state.previous[start:], state.force[start:])


@fma
def _advance(mobility, step, position, previous, force):
    """Moves points by a sample. One loop for each written array: with more, the compiler cannot rule out an overlap,
    and does not vectorise."""
    points = np.uint64(step.size)
    for i in range(points):
        step[i] += mobility[i] * force[i]
    for i in range(points):
        previous[i] = position[i] + step[i]
    for i in range(points):
        position[i] = previous[i] - step[i]
    for i in range(points):
        force[i] = force.dtype.type(0)


def _parts(scene: Scene, context: BuildContext, present: Sequence[PresentType]) -> tuple[Batch, ...]:
    parts: list[Batch] = []
    for one in present:
        parts += expanded_forces(one, context) if one.kind.moves_points else [one.build(context)]
    mobility = mobility_of_all(scene, context)
    steps = Steps(np.uint64(first_moved(scene)), mobility, np.zeros_like(mobility))
    return (*parts, Batch(steps, initialize=initialize, integrate=integrate))


SEMI_IMPLICIT = Scheme(_parts)
