"""Which part of the K,B plane is looked at, in SI units."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hapsim.chart.hand import Hand
from hapsim.chart.round_numbers import round_up
from hapsim.errors import UsageError
from hapsim.theory import Configuration
from hapsim.theory.arrays import Bools, Floats

_FAR_SMALLER = 6.0  # an operating point that is this much below the whole region would look like its corner
_AROUND_POINT = 3.0  # then so much more than the point is looked at
_FAR_LARGER = 4.0  # of a family, a stable region that is this much larger than the smallest is not drawn whole
_MOST_DELAY = 40.0
_FAR_OUT = 3.0  # an operating point that is this much beyond the whole region is named instead of drawn


@dataclass(frozen=True)
class View:
    """A rectangle of the plane: K from 0 in N/m, simulated B in N·s/m."""

    K_to: float
    B_from: float
    B_to: float

    def mesh(self, columns: int, rows: int) -> tuple[Floats, Floats]:
        """Points all over it, (rows, columns); K is above 0."""
        K = self.K_to * np.linspace(1e-6, 1.0, columns)
        return tuple(np.meshgrid(K, np.linspace(self.B_from, self.B_to, rows)))  # type: ignore[return-value]

    def holds(self, K: Floats, B: Floats) -> Bools:
        """Whether a point is in it, or so near that a line to it leaves the picture."""
        return np.asarray(
            (np.abs(K / self.K_to - 0.5) <= 0.52)
            & (np.abs((B - self.B_from) / (self.B_to - self.B_from) - 0.5) <= 0.52)
        )

    def shows(self, K: float, B: float) -> bool:
        """Whether a single point is in it."""
        return 0.0 <= K <= self.K_to and self.B_from <= B <= self.B_to


@dataclass(frozen=True)
class StableRegion:
    """How far the stable region reaches."""

    K_to: float
    B_to: float


def stable_region(configuration: Configuration) -> StableRegion:
    """How far, N/m and N·s/m, K and B may go at best; NaN where nothing is stable."""
    count = 900 if configuration.delay < 8.0 else 200  # a late loop has many poles
    B = configuration.damping_unit * np.geomspace(1e-6, 1e3, count) - configuration.friction
    most = np.where(np.isfinite(most := configuration.stable_stiffness(B)[1]), most, np.nan)
    if not np.any(most > 0.0):
        return StableRegion(math.nan, math.nan)
    K_to = float(np.nanmax(most))
    return StableRegion(K_to, float(np.max(B[most > 1e-3 * K_to])))


def require_few_poles(configuration: Configuration) -> None:
    """UsageError where the loop is so late that nobody would wait for its picture."""
    if configuration.delay > _MOST_DELAY:
        raise UsageError(
            f"delay: found {configuration.delay:g} sample periods, expected at most {_MOST_DELAY:g} in a picture"
        )


def view_of(hands: Sequence[Hand], *, from_total: bool, K_to: float | None = None, B_to: float | None = None) -> View:
    """The whole stable region with the operating points; where these would be lost in its corner, what is near them.

    `from_total`: B begins where B + b0 is 0, otherwise at 0. `K_to`, `B_to`: N/m and N·s/m, in place of what is found.
    """
    require_few_poles(hands[0].configuration)
    configuration = hands[0].configuration
    require_few_poles(configuration)
    least = -configuration.friction if from_total else 0.0
    regions = [stable_region(hand.configuration) for hand in hands]
    K_whole = _seen_of([region.K_to for region in regions], configuration.stiffness_unit)
    B_whole = _seen_of([region.B_to - least for region in regions], configuration.damping_unit)
    simulated = [hand for hand in hands if hand.is_simulated]
    K = max((hand.stiffness for hand in simulated), default=0.0)
    B = max((hand.damping for hand in simulated), default=least)
    steady = max((float(hand.configuration.stable_damping(K)[0]) for hand in simulated), default=math.nan)
    K_found, B_found = _ends(K_whole, B_whole, K, max(B, steady if math.isfinite(steady) else B) - least, B - least)
    view = View(K_to or K_found, least, least + B_found if B_to is None else B_to)
    if view.B_to <= view.B_from:
        raise UsageError(f"--to-damping: found {view.B_to:g} N·s/m, expected more than {view.B_from:g}")
    return view


def _ends(K_whole: float, B_whole: float, K: float, B_steady: float, B: float) -> tuple[float, float]:
    """`B_steady`: the damping of the point, or what it would need to be stable."""
    if min(K, B_steady) > 0.0 and max(K / K_whole, B_steady / B_whole) < 1.0 / _FAR_SMALLER:
        return round_up(_AROUND_POINT * K), round_up(_AROUND_POINT * B_steady)
    # A point that is simulated far out does not make the rest too small to be seen.
    K_end, B_end = (max(1.08, 1.1 * x if x < _FAR_OUT else 0.0) for x in (K / K_whole, B / B_whole))
    return round_up(K_end * K_whole), round_up(B_end * B_whole)


def _seen_of(values: list[float], otherwise: float) -> float:
    """The largest, unless the smallest would not be seen beside it."""
    known = [value for value in values if math.isfinite(value)]
    return min(max(known), _FAR_LARGER * min(known)) if known else otherwise
