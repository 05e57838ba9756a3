"""What forces make of positions, from pushes to either side, with its uncertainty.

The second difference of the position, x[k+1] - 2 x[k] + x[k-1], is T²/2m times the forces of the two samples around
k. Friction, a spring and a constant pull are regressed beside the forces, so that a device that moves by itself is
judged too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_PARTS = 8  # of the record: what their estimates differ by is the uncertainty


@dataclass(frozen=True)
class Estimate:
    """Coefficients of the forces, in m/N, and their standard deviations; shape (forces,)."""

    values: NDArray[np.float64]
    deviations: NDArray[np.float64]
    sum_deviation: float
    """Of the values' sum."""
    rows: int

    @property
    def total(self) -> float:
        """The values' sum."""
        return float(self.values.sum())

    @property
    def significance(self) -> float:
        """How many standard deviations the sum is from zero; 0 where no force moved the position by a count."""
        if self.sum_deviation > 0:
            return abs(self.total) / self.sum_deviation
        return np.inf if self.total else 0.0


def estimate(positions: Mapping[int, float], forces_of: Callable[[int], Sequence[float] | None]) -> Estimate | None:
    """Returns the coefficients of the forces by least squares, their deviations by the jackknife (leaving out one part
    of the record after the other); None if there are too few rows, or a force that is zero in all of them.

    Args:
        positions: m, by sample.
        forces_of: returns the forces in N that may explain the second difference at a sample; None to pass it over.
    """
    rows = []
    for k in sorted(positions):
        forces = forces_of(k) if k - 1 in positions and k + 1 in positions else None
        if forces is not None:
            before, now, after = positions[k - 1], positions[k], positions[k + 1]
            rows.append((after - 2 * now + before, before, now - before, *forces))
    if len(rows) < 8 * _PARTS:
        return None
    table = np.array(rows)
    bend, drift, pushes = table[:, 0], table[:, 1:3] - table[:, 1:3].mean(axis=0), table[:, 3:]
    if not np.abs(pushes).max(axis=0).all():
        return None
    scale = np.abs(drift).max(axis=0)
    columns = np.column_stack([pushes, np.ones(len(rows)), drift / np.where(scale > 0, scale, 1.0)])

    def solve(left_out: NDArray[np.int64]) -> NDArray[np.float64]:
        kept, wanted = np.delete(columns, left_out, axis=0), np.delete(bend, left_out)
        return np.asarray(np.linalg.lstsq(kept, wanted, rcond=None)[0][: pushes.shape[1]], np.float64)

    parts = np.array([solve(part) for part in np.array_split(np.arange(len(rows)), _PARTS)])
    factor = np.sqrt(_PARTS - 1)
    nothing = np.empty(0, np.int64)
    return Estimate(solve(nothing), factor * parts.std(axis=0), float(factor * parts.sum(axis=1).std()), len(rows))
