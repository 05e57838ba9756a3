"""The classical Runge-Kutta scheme of fourth order: forces at four instants of each sample period.

With the step w = T v and c = (T²/m) F(x, w), and F computed at

    c1: x, w        c2: x + w/2, w + c1/2        c3: x + w/2 + c1/4, w + c2/2        c4: x + w + c2/2, w + c3

    x[n+1] = x + w + (c1 + c2 + c3)/6,           w[n+1] = w + (c1 + 2 c2 + 2 c3 + c4)/6

Links without memory are computed at each instant. Those with memory are computed once, at the sample, and their force
is held. Device points and grounds continue during the period at their last velocity. The force on the hand is that at
the sample.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol.compiled import new_record
from hapsim.compiling import fma, inlined
from hapsim.compiling.native import Behind, value_of
from hapsim.cordis.build_context import BuildContext, PresentType, Scheme
from hapsim.cordis.dispatch import CALLS, Batch, Column, TickState, action, call_all, calls_of
from hapsim.cordis.modules.pick_ups import PICK_UP
from hapsim.cordis.modules.points import CELL
from hapsim.cordis.schemes.force_expansion import expanded_forces, first_moved, mobility_of_all
from hapsim.scene import Scene


class KeptForce(NamedTuple):
    """The force at the sample by links with memory: N, shape (N,)."""

    force: Column


class RungeKutta(NamedTuple):
    """The points from number `start` on: their T²/m in m/N, and c1, c2, c3 in m; shape (n,). `at`, and behind
    `at_address`: all points at an instant between two samples. `links`: CALLS made at every instant."""

    start: np.uint64
    mobility: Column
    change: tuple[Column, Column, Column]
    kept: KeptForce
    at: TickState
    at_address: np.uint64
    links: Any


@action
def keep_force(kept, state):
    """Keeps the force so far, which is that of the links with memory."""
    kept, state = value_of(kept), value_of(state)
    for p in range(np.uint64(kept.force.size)):
        kept.force[p] = state.force[p]


@action
def integrate(points, state):
    """Moves every point by one sample."""
    points, state = value_of(points), value_of(state)
    start, instant, mobility = points.start, points.at, points.mobility
    x, before = state.position[start:], state.previous[start:]
    y, y_before = instant.position[start:], instant.previous[start:]
    force = instant.force[start:]
    c1, c2, c3 = points.change
    quarter, half, one = x.dtype.type(0.25), x.dtype.type(0.5), x.dtype.type(1)
    _change(mobility, state.force[start:], c1)
    _advance_points(x, before, half, c1, x.dtype.type(0), y)
    _advance_previous(x, before, y, half, c1, y_before)
    _add_forces_at(points, state, half)
    _change(mobility, force, c2)
    _advance_points(x, before, half, c1, quarter, y)
    _advance_previous(x, before, y, half, c2, y_before)
    _add_forces_at(points, state, half)
    _change(mobility, force, c3)
    _advance_points(x, before, one, c2, half, y)
    _advance_previous(x, before, y, one, c3, y_before)
    _add_forces_at(points, state, one)
    _finish(mobility, force, x, before, points.change, y)
    for i in range(np.uint64(c1.size)):
        state.force[start + i] = x.dtype.type(0)


@inlined
def _add_forces_at(points, state, share):
    """Adds the forces at an instant, this share of a sample period after the sample. The scheme has already moved its
    points there."""
    at = points.at
    for p in range(points.start):
        way = state.position[p] - state.previous[p]
        at.position[p] = state.position[p] + share * way
        at.previous[p] = at.position[p] - way
    for p in range(np.uint64(points.kept.force.size)):
        at.force[p] = points.kept.force[p]
    call_all(points.links, points.at_address)


# One loop for each written array: with more, the compiler cannot rule out an overlap, and does not vectorise.


@fma
def _change(mobility, force, change):
    for i in range(np.uint64(change.size)):
        change[i] = mobility[i] * force[i]


@fma
def _advance_points(x, before, share, change, of_change, y):
    """Computes the points' positions after this share of their step and of a change."""
    for i in range(np.uint64(y.size)):
        y[i] = x[i] + (share * (x[i] - before[i]) + of_change * change[i])


@fma
def _advance_previous(x, before, y, share, change, y_before):
    """Computes the positions one present step before these."""
    for i in range(np.uint64(y.size)):
        y_before[i] = y[i] - ((x[i] - before[i]) + share * change[i])


@fma
def _finish(mobility, force, x, before, change, after):
    """Writes x[n+1] to `before` and the position one step before it to `x`; `after` is scratch memory."""
    c1, c2, c3 = change
    two, sixth = x.dtype.type(2), x.dtype.type(1) / x.dtype.type(6)
    points = np.uint64(c1.size)
    for i in range(points):
        after[i] = x[i] + ((x[i] - before[i]) + sixth * (c1[i] + c2[i] + c3[i]))
    for i in range(points):
        c1[i] += two * (c2[i] + c3[i]) + mobility[i] * force[i]
    for i in range(points):
        x[i] = after[i] - ((x[i] - before[i]) + sixth * c1[i])
    for i in range(points):
        before[i] = after[i]


def _parts(scene: Scene, context: BuildContext, present: Sequence[PresentType]) -> tuple[Batch, ...]:
    per_sample: list[Batch] = []
    per_instant: list[Batch] = []
    for one in present:
        if one.kind.moves_points:
            per_instant += expanded_forces(one, context)
        else:
            part = one.build(context)
            remembers = part.memory is not None and one.kind is not CELL  # its memory is a rest position, not a force
            (per_sample if remembers or one.kind is PICK_UP else per_instant).append(part)
    size, mobility = context.state.force.size, mobility_of_all(scene, context)
    position, previous, force, kept = np.zeros((4, size), context.real)
    at = Behind(TickState(position, previous, force, context.state.velocity))
    actions = [(part.add_forces, Behind(part.numbers)) for part in per_instant if part.add_forces is not None]
    calls, pairs = new_record(CALLS), calls_of(actions, at)
    calls.pairs, calls.count = pairs.ctypes.data, len(pairs)
    change = (np.zeros_like(mobility), np.zeros_like(mobility), np.zeros_like(mobility))
    numbers = RungeKutta(
        np.uint64(first_moved(scene)), mobility, change, KeptForce(kept), at.value, np.uint64(at.address), calls
    )
    keeping = [Batch(numbers.kept, add_forces=keep_force)] if per_sample else []
    return (*per_sample, *keeping, *per_instant, Batch(numbers, integrate=integrate, kept=(at, actions, pairs)))


RK4 = Scheme(_parts)
