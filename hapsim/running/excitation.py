"""Forces that are added to the scene's: pushes that ring a hand, or a period that is repeated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Excitation:
    """Pushes on one channel, for `ticks` samples every `every` samples from sample `start` on, to one side and to the
    other in turn: from `force` in N down to half of it, each different. They pass the guards like any force.
    `first`: one at the very beginning too."""

    channel: int
    force: float
    ticks: int
    every: int
    start: int
    first: bool


@dataclass(frozen=True, eq=False)
class PeriodicExcitation:
    """Forces on one channel, one for each sample by the device's count, in N, (N,) of them before they begin again:
    sample n has `forces[n % N]`, whether or not positions were lost. They pass the guards like any force."""

    channel: int
    forces: NDArray[np.float64]

    def __post_init__(self) -> None:
        forces = np.ascontiguousarray(self.forces, dtype=np.float64)
        if forces.ndim != 1 or forces.size == 0 or not np.all(np.isfinite(forces)):
            raise ValueError(f"forces: found shape {forces.shape}, expected finite numbers in one row")
        object.__setattr__(self, "forces", forces)
