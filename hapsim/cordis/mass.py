"""The mass: second-order centred scheme (Florens et al., §6, Figure 5a; CORDIS: MAS).

(m / T²) (x[n+1] - 2 x[n] + x[n-1]) = F[n]
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hapsim.compiled import inlined
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


MASS = Kind(_select, _build)


@moves(Masses)
@inlined
def advance(group, moment):
    """Moves every mass by one sample."""
    for i in range(group.mobility.size):
        p = group.start + i
        x = moment.position[p]
        moment.following[p] = x + x - moment.previous[p] + group.mobility[i] * moment.force[p]
