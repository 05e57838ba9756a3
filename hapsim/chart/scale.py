"""The units in which the K,B plane is drawn: SI, or the paper's normalised ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats

Number = TypeVar("Number", float, Floats)


@dataclass(frozen=True)
class Scale:
    """From N/m and N·s/m to what an axis says."""

    stiffness: float
    """N/m that are drawn as 1."""
    damping: float
    """N·s/m that are drawn as 1."""
    offset: float
    """N·s/m that are added to B: the real friction, where the axis shows the total."""
    normalised: bool
    total: bool

    def of_stiffness(self, K: Number) -> Number:
        """As drawn, of N/m."""
        return K / self.stiffness

    def of_simulated(self, B: Number) -> Number:
        """As drawn, of a simulated damping in N·s/m."""
        return (B + self.offset) / self.damping

    def of_damping(self, b: Number) -> Number:
        """As drawn, of a felt damping, N·s/m."""
        return b / self.damping

    @property
    def stiffness_axis(self) -> str:
        """What stands at the K axis."""
        return "simulated stiffness  $K\\,T^2/m$" if self.normalised else "simulated stiffness  $K$  (N/m)"

    @property
    def damping_axis(self) -> str:
        """What stands at the B axis."""
        if self.normalised:
            return "total damping  $(B + b_0)\\,T/m$" if self.total else "simulated damping  $B\\,T/m$"
        return "total damping  $B + b_0$  (N·s/m)" if self.total else "simulated damping  $B$  (N·s/m)"

    @property
    def simulated(self) -> str:
        """What the B axis shows."""
        return "B + b_0" if self.total else "B"

    @property
    def k_name(self) -> str:
        """The felt stiffness, with its unit."""
        return "$k\\,T^2/m$" if self.normalised else "$k$ (N/m)"

    @property
    def b_name(self) -> str:
        """The felt damping, with its unit."""
        return "$b\\,T/m$" if self.normalised else "$b$ (N·s/m)"

    @property
    def columns(self) -> tuple[str, str, str, str]:
        """Names of K, B, k, b in a data file."""
        B = "B_plus_b0" if self.total else "B"
        if self.normalised:
            return "K_T2_per_m", f"{B}_T_per_m", "k_T2_per_m", "b_T_per_m"
        return "K_N_per_m", f"{B}_Ns_per_m", "k_N_per_m", "b_Ns_per_m"


def scale_of(configuration: Configuration, *, normalised: bool, total: bool) -> Scale:
    """The axes of one configuration's plane; `total`: the B axis shows B + b0, as the paper's Figure 9 does."""
    return Scale(
        stiffness=configuration.stiffness_unit if normalised else 1.0,
        damping=configuration.damping_unit if normalised else 1.0,
        offset=configuration.friction if total else 0.0,
        normalised=normalised,
        total=total,
    )


def thinned(x: Floats, y: Floats, step: float) -> NDArray[np.intp]:
    """Indices of a line's points that are at least `step` apart, its ends and its gaps; NaN is a gap, one is kept."""
    kept: list[int] = []
    last: int | None = None
    for i in range(x.size):
        if not np.isfinite(x[i] + y[i]):
            if last is not None:
                if kept[-1] != i - 1:
                    kept.append(i - 1)
                kept.append(i)
            last = None
            continue
        if last is None or abs(x[i] - x[last]) + abs(y[i] - y[last]) >= step:
            kept.append(i)
            last = i
    if last is not None and kept[-1] != x.size - 1:
        kept.append(x.size - 1)
    return np.array(kept, dtype=np.intp)
