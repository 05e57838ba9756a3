"""The axes of the K,B plane: which part of it is drawn, and in which units (SI, or the paper's normalised ones)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.theory import Configuration
from hapsim.theory.arrays import Bools, Floats

_FAR_SMALLER = 6.0  # an operating point this much below the whole region would sit in its corner
_AROUND_POINT = 3.0  # so the axes then end at this multiple of the point
_FAR_LARGER = 4.0  # of several masses, a stable region this much larger than the smallest is not drawn whole
_FAR_OUT = 3.0  # an operating point this much beyond the whole region is named in the legend, not drawn
_MOST_DELAY = 40.0  # sample periods: the poles of a later loop take too long to find all over a picture

Number = TypeVar("Number", float, Floats)


@dataclass(frozen=True)
class View:
    """A rectangle of the plane: K from 0 in N/m, simulated B in N·s/m."""

    K_to: float
    B_from: float
    B_to: float

    def holds(self, K: Floats, B: Floats) -> Bools:
        """Returns whether points lie in it, or so near that a line to them leaves the picture."""
        across, up = K / self.K_to - 0.5, (B - self.B_from) / (self.B_to - self.B_from) - 0.5
        return np.asarray((np.abs(across) <= 0.52) & (np.abs(up) <= 0.52))

    def shows(self, K: float, B: float) -> bool:
        """Returns whether a single point lies in it."""
        return 0.0 <= K <= self.K_to and self.B_from <= B <= self.B_to


@dataclass(frozen=True)
class Scale:
    """Converts N/m and N·s/m to the axes' units."""

    stiffness: float
    """N/m that are drawn as 1."""
    damping: float
    """N·s/m that are drawn as 1."""
    offset: float
    """N·s/m that are added to B: the real friction, where the axis shows the total."""
    normalised: bool
    total: bool

    def of_stiffness(self, K: Number) -> Number:
        """Returns a stiffness as drawn, from N/m."""
        return K / self.stiffness

    def of_simulated(self, B: Number) -> Number:
        """Returns a simulated damping as drawn, from N·s/m."""
        return (B + self.offset) / self.damping

    def of_damping(self, b: Number) -> Number:
        """Returns a felt damping as drawn, from N·s/m."""
        return b / self.damping

    @property
    def simulated(self) -> str:
        """What the B axis shows."""
        return "B + b_0" if self.total else "B"

    @property
    def axis_labels(self) -> tuple[str, str]:
        """Labels of the K axis and of the B axis."""
        K, B = ("$K\\,T^2/m$", "$B\\,T/m$") if self.normalised else ("$K$  (N/m)", "$B$  (N·s/m)")
        total = B.replace("B", f"({self.simulated})" if self.normalised else self.simulated)
        return f"simulated stiffness  {K}", f"total damping  {total}" if self.total else f"simulated damping  {B}"

    @property
    def felt_names(self) -> tuple[str, str]:
        """Names of the felt k and b, with their units."""
        return ("$k\\,T^2/m$", "$b\\,T/m$") if self.normalised else ("$k$ (N/m)", "$b$ (N·s/m)")

    @property
    def columns(self) -> list[str]:
        """Names of K, B, k, b in a data file."""
        stiffness, damping = ("T2_per_m", "T_per_m") if self.normalised else ("N_per_m", "Ns_per_m")
        B = "B_plus_b0" if self.total else "B"
        return [f"K_{stiffness}", f"{B}_{damping}", f"k_{stiffness}", f"b_{damping}"]


def scale_of(configuration: Configuration, *, normalised: bool, total: bool) -> Scale:
    """Returns the units of one configuration's plane. `total`: the B axis shows B + b0, as in the paper's Figure 9."""
    units = (configuration.stiffness_unit, configuration.damping_unit) if normalised else (1.0, 1.0)
    return Scale(*units, configuration.friction if total else 0.0, normalised, total)


def stable_region(configuration: Configuration) -> tuple[float, float]:
    """Returns the largest stable K (N/m), and the largest B (N·s/m) at which a spring is stable; NaN if nothing is."""
    count = 900 if configuration.delay < 8.0 else 200  # a late loop has many poles
    B = configuration.damping_unit * np.geomspace(1e-6, 1e3, count) - configuration.friction
    most = configuration.stable_stiffness(B)[1]
    most = np.where(np.isfinite(most), most, np.nan)
    if not np.any(most > 0.0):
        return math.nan, math.nan
    K_to = float(np.nanmax(most))
    return K_to, float(np.max(B[most > 1e-3 * K_to]))


def view_of(hands: Sequence[Hand], *, from_total: bool, K_to: float | None = None, B_to: float | None = None) -> View:
    """Returns the whole stable region with the operating points, or the points' surroundings where the whole is much
    larger.

    Args:
        hands: one, or one for each mass.
        from_total: B begins where B + b0 is 0, otherwise at 0.
        K_to, B_to: the ends of the axes in N/m and N·s/m, if they are given.
    """
    configuration = hands[0].configuration
    if configuration.delay > _MOST_DELAY:
        found = f"delay: found {configuration.delay:g} sample periods"
        raise UsageError(f"{found}, expected at most {_MOST_DELAY:g} in a picture")
    least = -configuration.friction if from_total else 0.0
    regions = [stable_region(hand.configuration) for hand in hands]
    K_whole = _drawn_whole([K for K, _ in regions], configuration.stiffness_unit)
    B_whole = _drawn_whole([B - least for _, B in regions], configuration.damping_unit)
    simulated = [hand for hand in hands if hand.is_simulated]
    K = max((hand.stiffness for hand in simulated), default=0.0)
    B = max((hand.damping for hand in simulated), default=least)
    # The damping that would make an unstable point stable is drawn too.
    steady = max((float(hand.configuration.stable_damping(K)[0]) for hand in simulated), default=math.nan)
    B_needed = float(np.fmax(B, steady)) - least
    if min(K, B_needed) > 0.0 and max(K / K_whole, B_needed / B_whole) < 1.0 / _FAR_SMALLER:
        K_found, B_found = _AROUND_POINT * K, _AROUND_POINT * B_needed
    else:
        K_found, B_found = (
            end * max(1.08, 1.1 * value / end if value < _FAR_OUT * end else 0.0)
            for value, end in ((K, K_whole), (B - least, B_whole))
        )
    view = View(K_to or K_found, least, least + B_found if B_to is None else B_to)
    if view.B_to <= view.B_from:
        raise UsageError(f"--to-damping: found {view.B_to:g} N·s/m, expected more than {view.B_from:g}")
    return view


def _drawn_whole(ends: list[float], otherwise: float) -> float:
    """Returns the largest end, limited so that the smallest stays visible."""
    known = [end for end in ends if math.isfinite(end)]
    return min(max(known), _FAR_LARGER * min(known)) if known else otherwise
