"""The classical Runge-Kutta scheme of fourth order: forces at four instants of each sample period.

With the step w = T v and c = (T²/m) F(x, w), where F is asked at

    c1: x, w        c2: x + w/2, w + c1/2        c3: x + w/2 + c1/4, w + c2/2        c4: x + w + c2/2, w + c3

    x[n+1] = x + w + (c1 + c2 + c3)/6,           w[n+1] = w + (c1 + 2 c2 + 2 c3 + c4)/6

Every link that remembers nothing is asked at all four; those that do are asked once, and their force is held. Device
points and grounds go on during the period as they went in the last. The force in the hand is that of the first instant.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiled import fused, inlined
from hapsim.cordis.acting import moves, pull_all, pulls
from hapsim.cordis.kind import Column, Frame
from hapsim.cordis.moment import Moment
from hapsim.cordis.schemes.pulled import first_moved, mobility_of_all, moves_points, pulled
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.scene import Scene


class HeldForce(NamedTuple):
    """What the links that remember pull at the sample: N, shape (N,)."""

    force: Column


class Between(NamedTuple):
    """All points at an instant between two samples; shape (N,)."""

    position: Column
    previous: Column
    force: Column


class RungeKutta(NamedTuple):
    """The points from number `start` on: T²/m in m/N; c1, c2, c3 in m; shape (n,)."""

    start: np.uint64
    mobility: Column
    change: tuple[Column, Column, Column]
    between: Between
    held: HeldForce
    links: tuple[Any, ...]
    """The parts that are asked at every instant."""


def _parts(scene: Scene, frame: Frame, taken: Sequence[Taken], _rows: Column) -> tuple[Any, ...]:
    once: list[Any] = []
    always: list[Any] = []
    for one in taken:
        if moves_points(one.kind):
            always += pulled(one, frame)
        else:
            (always if one.kind.forgets else once).append(one.kind.build(one.modules, one.columns, frame))
    mobility = mobility_of_all(scene, frame)
    held = HeldForce(np.zeros(frame.points, frame.real))
    between = Between(*np.zeros((3, frame.points), frame.real))
    change = (np.zeros_like(mobility), np.zeros_like(mobility), np.zeros_like(mobility))
    mover = RungeKutta(np.uint64(first_moved(scene)), mobility, change, between, held, tuple(always))
    return (*once, *([held] if once else []), *always, mover)


RK4 = Scheme(_parts)


@pulls(HeldForce)
@inlined
def hold(held, moment):
    """Keeps what has been pulled so far, by the links that remember."""
    for p in range(np.uint64(held.force.size)):
        held.force[p] = moment.force[p]


@moves(RungeKutta)
@inlined
def advance_runge_kutta(points, moment):
    """Moves every point by one sample."""
    between, start = points.between, points.start
    x, before = moment.position[start:], moment.previous[start:]
    y, y_before = between.position[start:], between.previous[start:]
    force, mobility = between.force[start:], points.mobility
    c1, c2, c3 = points.change
    instant = Moment(
        between.position, between.previous, moment.following, between.force, moment.devices, moment.velocity
    )
    quarter, half, one = x.dtype.type(0.25), x.dtype.type(0.5), x.dtype.type(1)
    _change(mobility, moment.force[start:], c1)
    _go(x, before, half, c1, x.dtype.type(0), y)
    _go_before(x, before, y, half, c1, y_before)
    _pull(points, instant, moment, half)
    _change(mobility, force, c2)
    _go(x, before, half, c1, quarter, y)
    _go_before(x, before, y, half, c2, y_before)
    _pull(points, instant, moment, half)
    _change(mobility, force, c3)
    _go(x, before, one, c2, half, y)
    _go_before(x, before, y, one, c3, y_before)
    _pull(points, instant, moment, one)
    _finish(mobility, force, x, before, points.change, moment.following[start:])
    for i in range(np.uint64(c1.size)):
        moment.force[start + i] = x.dtype.type(0)


@inlined
def _pull(points, instant, moment, share):
    """The forces at an instant, which is this share of a sample period after the sample."""
    for p in range(points.start):
        way = moment.position[p] - moment.previous[p]
        instant.position[p] = moment.position[p] + share * way
        instant.previous[p] = instant.position[p] - way
    for p in range(np.uint64(points.held.force.size)):
        instant.force[p] = points.held.force[p]
    pull_all(points.links, instant)


# One loop for each array that is written: more at once the compiler does not take for apart from each other, and then
# it moves no two points at a time.


@fused
def _change(mobility, force, change):
    for i in range(np.uint64(change.size)):
        change[i] = mobility[i] * force[i]


@fused
def _go(x, before, share, change, of_change, y):
    """Where the points are after this share of their step, and of a change."""
    for i in range(np.uint64(y.size)):
        y[i] = x[i] + (share * (x[i] - before[i]) + of_change * change[i])


@fused
def _go_before(x, before, y, share, change, y_before):
    """Where they would have been at the step that they have by then."""
    for i in range(np.uint64(y.size)):
        y_before[i] = y[i] - ((x[i] - before[i]) + share * change[i])


@fused
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
