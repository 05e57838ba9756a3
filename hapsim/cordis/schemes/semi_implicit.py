"""The semi-implicit (symplectic) Euler scheme, with the step w = T v that each mass makes stored itself.

    w[n+1] = w[n] + (T²/m) F[n],      x[n+1] = x[n] + w[n+1]

is CORDIS's centred scheme: w[n] = x[n] - x[n-1] by the second equation, and the first with it is
x[n+1] - 2 x[n] + x[n-1] = (T²/m) F[n]. Not so in numbers of finite length. There x[n] - x[n-1] is wrong by the rounding
of two positions, about an ulp of x, and that error is carried on as velocity; a step that is stored itself is rounded
to an ulp of its own, and what is lost where it is added to the position never comes back into it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, settles
from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.schemes.pulled import first_moved, mobility_of_all, moves_points, pulled
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.scene import Scene


class Steps(NamedTuple):
    """The points from number `start` on: T²/m in m/N, and w in m; shape (n,)."""

    start: np.uint64
    mobility: Column
    step: Column


def _parts(scene: Scene, frame: Frame, taken: Sequence[Taken], _rows: Column) -> tuple[Any, ...]:
    parts: list[Any] = []
    for one in taken:
        parts += pulled(one, frame) if moves_points(one.kind) else [one.kind.build(one.modules, one.columns, frame)]
    mobility = mobility_of_all(scene, frame)
    return (*parts, Steps(np.uint64(first_moved(scene)), mobility, np.zeros_like(mobility)))


SEMI_IMPLICIT = Scheme(_parts)


@settles(Steps)
@inlined
def settle_steps(points, moment):
    """Before the first tick: the steps that the points come with."""
    for i in range(np.uint64(points.step.size)):
        points.step[i] = moment.position[points.start + i] - moment.previous[points.start + i]


@moves(Steps)
@inlined
def advance_steps(points, moment):
    """Moves every point by one sample; what becomes its previous position is where the step came from."""
    start = points.start
    _advance(points.mobility, points.step, moment.position[start:], moment.following[start:], moment.force[start:])


@fused
def _advance(mobility, step, position, following, force):
    """One loop for each array that is written: more at once the compiler does not take for apart from each other, and
    then it moves no two points at a time."""
    points = np.uint64(step.size)
    for i in range(points):
        step[i] += mobility[i] * force[i]
    for i in range(points):
        following[i] = position[i] + step[i]
    for i in range(points):
        position[i] = following[i] - step[i]
    for i in range(points):
        force[i] = force.dtype.type(0)
