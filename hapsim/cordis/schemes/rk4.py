"""The classical Runge-Kutta scheme of fourth order: forces at four instants of each sample period.

With the step w = T v and c = (T²/m) F(x, w), where F is asked at

    c1: x, w        c2: x + w/2, w + c1/2        c3: x + w/2 + c1/4, w + c2/2        c4: x + w + c2/2, w + c3

    x[n+1] = x + w + (c1 + c2 + c3)/6,           w[n+1] = w + (c1 + 2 c2 + 2 c3 + c4)/6

Which links are asked at all four, and where device points and grounds are meanwhile, stands in `instants.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiling import fma
from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import Part, action
from hapsim.cordis.schemes.instants import Instants, add_forces_at, instants_of
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.cordis.tick_state import Column
from hapsim.scene import Scene


class RungeKutta(NamedTuple):
    """c1, c2, c3 in m, of the points that the scheme moves; shape (n,)."""

    instants: Instants
    change: tuple[Column, Column, Column]


@action
def integrate(points, state):
    """Moves every point by one sample."""
    points, state = value_of(points), value_of(state)
    instants = points.instants
    start, instant = instants.start, instants.at
    x, before = state.position[start:], state.previous[start:]
    y, y_before = instant.position[start:], instant.previous[start:]
    force, mobility = instant.force[start:], instants.mobility
    c1, c2, c3 = points.change
    quarter, half, one = x.dtype.type(0.25), x.dtype.type(0.5), x.dtype.type(1)
    _change(mobility, state.force[start:], c1)
    _go(x, before, half, c1, x.dtype.type(0), y)
    _go_before(x, before, y, half, c1, y_before)
    add_forces_at(instants, state, half)
    _change(mobility, force, c2)
    _go(x, before, half, c1, quarter, y)
    _go_before(x, before, y, half, c2, y_before)
    add_forces_at(instants, state, half)
    _change(mobility, force, c3)
    _go(x, before, one, c2, half, y)
    _go_before(x, before, y, one, c3, y_before)
    add_forces_at(instants, state, one)
    _finish(mobility, force, x, before, points.change, state.following[start:])
    for i in range(np.uint64(c1.size)):
        state.force[start + i] = x.dtype.type(0)


# One loop for each array that is written: more at once the compiler does not take for apart from each other, and then
# it moves no two points at a time.


@fma
def _change(mobility, force, change):
    for i in range(np.uint64(change.size)):
        change[i] = mobility[i] * force[i]


@fma
def _go(x, before, share, change, of_change, y):
    """Where the points are after this share of their step, and of a change."""
    for i in range(np.uint64(y.size)):
        y[i] = x[i] + (share * (x[i] - before[i]) + of_change * change[i])


@fma
def _go_before(x, before, y, share, change, y_before):
    """Where they would have been at the step that they have by then."""
    for i in range(np.uint64(y.size)):
        y_before[i] = y[i] - ((x[i] - before[i]) + share * change[i])


@fma
def _finish(mobility, force, x, before, change, following):
    c1, c2, c3 = change
    two, sixth = x.dtype.type(2), x.dtype.type(1) / x.dtype.type(6)
    points = np.uint64(c1.size)
    for i in range(points):
        following[i] = x[i] + ((x[i] - before[i]) + sixth * (c1[i] + c2[i] + c3[i]))
    for i in range(points):
        c1[i] += two * (c2[i] + c3[i]) + mobility[i] * force[i]
    for i in range(points):
        x[i] = following[i] - ((x[i] - before[i]) + sixth * c1[i])


def _parts(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    instants = instants_of(scene, context, taken)
    mobility = instants.numbers.mobility
    change = (np.zeros_like(mobility), np.zeros_like(mobility), np.zeros_like(mobility))
    return instants.parts(integrate, RungeKutta(instants.numbers, change))


RK4 = Scheme(_parts)
