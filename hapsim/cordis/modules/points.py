"""The points of a scene: the ground (CORDIS: SOL), the mass (MAS) and the cell (CEL).

    ground   x[n] = position, which may change while the scene runs; that moves the dampers tied to it
    mass     (m / T²) (x[n+1] - 2 x[n] + x[n-1]) = F[n]          second-order centred (Florens et al., §6, Figure 5a)
    cell     a mass with F[n] = -K d[n] - (B/T) (d[n] - d[n-1]),          d: where it is minus where it rests

A change of a cell's rest position also changes d: a cell is a mass, a visco-elastic link and a ground. Masses and cells
are adjacent in memory, and one pass moves them all.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from hapsim.compiling.native import value_of
from hapsim.cordis.build_context import BatchType, BuildContext, all_of
from hapsim.cordis.dispatch import Batch, Column, Memory, action, fma_action
from hapsim.scene import Cell, Proxy


class Grounds(NamedTuple):
    """G grounds, which stand together from point `start` on; `rest`: m, shape (G,)."""

    start: np.uint64
    rest: Column


@action
def retarget(grounds, state):
    """Puts every ground at its rest position. Between changes both rows of positions have it."""
    grounds, state = value_of(grounds), value_of(state)
    for i in range(np.uint64(grounds.rest.size)):
        state.position[grounds.start + i] = grounds.rest[i]


class Masses(NamedTuple):
    """M masses, one type of material point after the other, from point `start` on; `mobility`: T²/m in m/N, (M,). 0 of
    a proxy, which coasts: its own part moves it on."""

    start: np.uint64
    mobility: Column


@fma_action
def integrate(group, state):
    """Moves every mass by one sample, and sets the force on it to zero."""
    group, state = value_of(group), value_of(state)
    first, end = group.start, group.start + np.uint64(group.mobility.size)
    x, before, force = state.position[first:end], state.previous[first:end], state.force[first:end]
    for i in range(np.uint64(group.mobility.size)):
        before[i] = x[i] + x[i] - before[i] + group.mobility[i] * force[i]
        force[i] = 0.0


class Cells(NamedTuple):
    """C cells, which stand together from point `start` on: K and B/T in N/m, rest in m, shape (C,). `rest_before`: m,
    of the sample before, shape (C,)."""

    start: np.uint64
    stiffness: Column
    damping_per_sample: Column
    rest: Column
    rest_before: Column


@action
def add_forces(group, state):
    """Adds the force of every cell's own spring and damper."""
    group, state = value_of(group), value_of(state)
    first, last = group.start, group.start + np.uint64(group.rest.size)
    position, previous, force = state.position[first:last], state.previous[first:last], state.force[first:last]
    for i in range(np.uint64(group.rest.size)):
        d = position[i] - group.rest[i]
        growth = d - (previous[i] - group.rest_before[i])
        force[i] -= group.stiffness[i] * d + group.damping_per_sample[i] * growth
        group.rest_before[i] = group.rest[i]


def _start(points: Mapping[str, Any], context: BuildContext) -> np.uint64:
    return np.uint64(context.number[next(iter(points))])


def _grounds(grounds: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    return Batch(Grounds(_start(grounds, context), *columns), retarget=retarget)


def _masses(masses: Mapping[str, Any], _columns: Sequence[Column], context: BuildContext) -> Batch:
    mobility = context.mobility([math.inf if isinstance(one, Proxy) else one.mass for one in masses.values()])
    return Batch(Masses(_start(masses, context), mobility), integrate=integrate)


def _cells(cells: Mapping[str, Any], columns: Sequence[Column], context: BuildContext) -> Batch:
    stiffness, damping, rest = columns
    before = rest.copy()
    numbers = Cells(_start(cells, context), stiffness, damping, rest, before)
    return Batch(numbers, add_forces=add_forces, memory=Memory(tuple(cells), {"rest_before": before}))


GROUND = BatchType(
    lambda scene: scene.grounds, _grounds, name="grounds", compiled_as="fixed points; a tick does not read them"
)
MASS = BatchType(
    lambda scene: scene.material_points,
    _masses,
    name="masses",
    compiled_as="one pass over contiguous memory",
    live=None,
    moves_points=True,
)
CELL = BatchType(
    all_of(Cell),
    _cells,
    name="cells",
    compiled_as="pulled to rest in one pass, without a name being looked up; they move with the masses",
)
