"""The mass: second-order centred scheme (Florens et al., §6, Figure 5a; CORDIS: MAS).

(m / T²) (x[n+1] - 2 x[n] + x[n-1]) = F[n]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiled import fused
from hapsim.cordis.acting import moves
from hapsim.cordis.kind import Column, Frame, Kind
from hapsim.scene import Cell, Mass, Scene


class Masses(NamedTuple):
    """M masses, those of cells last, which stand together from point `start` on; `mobility`: T²/m in m/N, (M,)."""

    start: int
    mobility: Column


def mobility_of(mass: Sequence[float] | float, frame: Frame) -> Column:
    """T²/m of masses in kg."""
    with np.errstate(over="ignore", divide="ignore"):  # the guard sees what comes of an infinity
        return np.asarray(1.0 / (np.asarray(mass, np.float64) * frame.rate * frame.rate), frame.real)


def _select(scene: Scene) -> Mapping[str, Mass | Cell]:
    return scene.masses | scene.cells


def _build(masses: Mapping[str, Mass | Cell], _columns: Sequence[Column], frame: Frame) -> Masses:
    return Masses(frame.number[next(iter(masses))], mobility_of([one.mass for one in masses.values()], frame))


MASS = Kind(
    _select,
    _build,
    name="masses",
    compiled_as="one pass over contiguous memory",
)


@moves(Masses)
@fused
def advance(group, moment):
    """Moves every mass by one sample, and uses up the force on it."""
    first, end = group.start, group.start + group.mobility.size
    x, before, after = moment.position[first:end], moment.previous[first:end], moment.following[first:end]
    force = moment.force[first:end]
    for i in range(group.mobility.size):
        after[i] = x[i] + x[i] - before[i] + group.mobility[i] * force[i]
        force[i] = 0.0
