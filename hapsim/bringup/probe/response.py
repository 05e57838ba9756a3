"""What forces make of positions: the response by lags, from pushes to either side, with its uncertainty.

The second difference of the position, x[k+1] - 2 x[k] + x[k-1], is T²/2m times the forces of the two samples around
k. A force F[n] that answers sample n and acts from tick n + 1 on is that of sample n + 1; so of F[k], F[k-1], F[k-2] a
device that keeps PROTOCOL.md, section 6, shows the second and the third, in equal parts (the second alone, doubled,
where it gives impulses). F[k], which came during the sample that k + 1 ends, shows in a device that puts a force out on
arrival.
Friction, a spring and a constant pull are regressed beside it, so that a device that moves by itself is judged too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

LAGS = 5
_PARTS = 8  # of the record: what their estimates differ by is the uncertainty


@dataclass(frozen=True)
class Estimate:
    """Coefficients of the forces, and their standard deviations; shape (regressors,)."""

    values: NDArray[np.float64]
    deviations: NDArray[np.float64]
    sum_deviation: float
    """Of the values' sum."""
    rows: int

    @property
    def total(self) -> float:
        return float(self.values.sum())

    @property
    def significance(self) -> float:
        """How many standard deviations the sum is from zero."""
        return abs(self.total) / self.sum_deviation if self.sum_deviation > 0 else np.inf


@dataclass(frozen=True)
class Row:
    """One second difference, and what may explain it."""

    bend: float
    """m."""
    forces: tuple[float, ...]
    """N."""
    drift: tuple[float, float]
    """The position before, and its change, m."""


def rows_by_lag(positions: Mapping[int, float], forces: Mapping[int, float], fresh: Mapping[int, bool]) -> list[Row]:
    """Where every position around came. Positions m, forces N (each the answer to its sample), by sample. The forces
    have time to live 0: one that missed its deadline, as POSITION_HELD says of the next sample, is not acted on."""

    def in_time(n: int) -> float:
        return forces.get(n, 0.0) if fresh.get(n + 1, False) else 0.0

    rows = []
    for k in sorted(positions):
        if all(j in positions for j in range(k - LAGS, k + 2)):
            x0, x1, x2 = positions[k - 1], positions[k], positions[k + 1]
            rows.append(Row(x2 - 2 * x1 + x0, tuple(in_time(k - lag) for lag in range(LAGS)), (x0, x1 - x0)))
    return rows


def estimate(rows: Sequence[Row]) -> Estimate | None:
    """The forces' coefficients by least squares; their deviations by leaving out one part of the record after the
    other. None where there are too few rows, or forces that never changed."""
    if len(rows) < 8 * _PARTS:
        return None
    bend = np.array([row.bend for row in rows])
    forces = np.array([row.forces for row in rows])
    drift = np.array([row.drift for row in rows])
    drift -= drift.mean(axis=0)
    scale = np.abs(drift).max(axis=0)
    columns = np.column_stack([forces, np.ones(len(rows)), drift / np.where(scale > 0, scale, 1.0)])
    if not np.abs(forces).max(axis=0).all():
        return None
    count = forces.shape[1]
    values = _solution(columns, bend)[:count]
    parts = np.array_split(np.arange(len(rows)), _PARTS)
    left_out = np.array([_without(columns, bend, part)[:count] for part in parts])
    factor = np.sqrt((_PARTS - 1) / _PARTS)
    spread = factor * np.sqrt(((left_out - left_out.mean(axis=0)) ** 2).sum(axis=0))
    sums = left_out.sum(axis=1)
    of_sum = float(factor * np.sqrt(((sums - sums.mean()) ** 2).sum()))
    return Estimate(values, np.asarray(spread, np.float64), of_sum, len(rows))


def _without(columns: NDArray[np.float64], bend: NDArray[np.float64], part: NDArray[np.int64]) -> NDArray[np.float64]:
    return _solution(np.delete(columns, part, axis=0), np.delete(bend, part))


def _solution(columns: NDArray[np.float64], bend: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(np.linalg.lstsq(columns, bend, rcond=None)[0], np.float64)
