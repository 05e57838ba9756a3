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

from firmware_protocol.records import new_record
from hapsim.compiling import fma, inlined
from hapsim.compiling.native import Behind, value_of
from hapsim.cordis.build_context import BuildContext
from hapsim.cordis.dispatch import CALLS, Part, action, call_all, calls_of
from hapsim.cordis.schemes.force_expansion import expanded_forces, first_moved, mobility_of_all
from hapsim.cordis.schemes.scheme import Scheme, Taken
from hapsim.cordis.tick_state import Column, TickState
from hapsim.scene import Scene


class KeptForce(NamedTuple):
    """The force at the sample of the links that remember: N, shape (N,)."""

    force: Column


class RungeKutta(NamedTuple):
    """The points from number `start` on: T²/m in m/N; c1, c2, c3 in m; shape (n,)."""

    start: np.uint64
    mobility: Column
    change: tuple[Column, Column, Column]
    kept: KeptForce
    instant: TickState
    """All points at an instant between two samples,"""
    instant_at: np.uint64
    """behind this address too, for"""
    links: Any
    """the calls that are made at every instant: CALLS."""


@action
def keep_force(kept, state):
    """Keeps what has been added up so far, by the links that remember."""
    kept, state = value_of(kept), value_of(state)
    for p in range(np.uint64(kept.force.size)):
        kept.force[p] = state.force[p]


@action
def integrate(points, state):
    """Moves every point by one sample."""
    points, state = value_of(points), value_of(state)
    start = points.start
    x, before = state.position[start:], state.previous[start:]
    y, y_before = points.instant.position[start:], points.instant.previous[start:]
    force, mobility = points.instant.force[start:], points.mobility
    c1, c2, c3 = points.change
    quarter, half, one = x.dtype.type(0.25), x.dtype.type(0.5), x.dtype.type(1)
    _change(mobility, state.force[start:], c1)
    _go(x, before, half, c1, x.dtype.type(0), y)
    _go_before(x, before, y, half, c1, y_before)
    _add_forces(points, state, half)
    _change(mobility, force, c2)
    _go(x, before, half, c1, quarter, y)
    _go_before(x, before, y, half, c2, y_before)
    _add_forces(points, state, half)
    _change(mobility, force, c3)
    _go(x, before, one, c2, half, y)
    _go_before(x, before, y, one, c3, y_before)
    _add_forces(points, state, one)
    _finish(mobility, force, x, before, points.change, state.following[start:])
    for i in range(np.uint64(c1.size)):
        state.force[start + i] = x.dtype.type(0)


@inlined
def _add_forces(points, state, share):
    """The forces at an instant, which is this share of a sample period after the sample."""
    instant = points.instant
    for p in range(points.start):
        way = state.position[p] - state.previous[p]
        instant.position[p] = state.position[p] + share * way
        instant.previous[p] = instant.position[p] - way
    for p in range(np.uint64(points.kept.force.size)):
        instant.force[p] = points.kept.force[p]
    call_all(points.links, points.instant_at)


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


class _InstantCalls:
    """The calls that are made at every instant, and what they need to stay where it is."""

    def __init__(self, links: Sequence[Part], state: TickState) -> None:
        position, previous, force = np.zeros((3, state.force.size), state.force.dtype)
        self.state = Behind(TickState(position, previous, position, force, state.velocity))
        numbers = [(part.add_forces, Behind(part.numbers)) for part in links if part.add_forces is not None]
        self._kept = (numbers, calls_of(numbers, self.state))
        self.calls = new_record(CALLS)
        self.calls.pairs, self.calls.count = self._kept[1].ctypes.data, len(self._kept[1])


def _parts(scene: Scene, context: BuildContext, taken: Sequence[Taken]) -> tuple[Part, ...]:
    once: list[Part] = []
    always: list[Part] = []
    for one in taken:
        if one.kind.moves_points:
            always += expanded_forces(one, context)
        else:
            part = one.build(context)
            (always if one.kind.memoryless or part.add_forces is None else once).append(part)
    mobility = mobility_of_all(scene, context)
    change = (np.zeros_like(mobility), np.zeros_like(mobility), np.zeros_like(mobility))
    kept = KeptForce(np.zeros_like(context.state.force))
    instant = _InstantCalls(always, context.state)
    mover = RungeKutta(
        np.uint64(first_moved(scene)),
        mobility,
        change,
        kept,
        instant.state.value,
        np.uint64(instant.state.address),
        instant.calls,
    )
    keeping = [Part(kept, add_forces=keep_force)] if once else []
    return (*once, *keeping, *always, Part(mover, integrate=integrate, kept=instant))


RK4 = Scheme(_parts)
