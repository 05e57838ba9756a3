"""The K,B plane (Florens et al., §5 and Figures 7 to 9): its axes, in SI units or the paper's normalised ones, and its
curves, each a line of points.

Points outside the view, and points that have no meaning, are NaN.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from hapsim.chart.figure import drawn_in
from hapsim.chart.hand import Hand
from hapsim.errors import UsageError
from hapsim.theory import Configuration
from hapsim.theory.arrays import Bools, Floats
from hapsim.units import Units

_FAR_SMALLER = 6.0  # an operating point this much below the whole region would sit in its corner
_AROUND_POINT = 3.0  # so the axes then end at this multiple of the point
_FAR_LARGER = 4.0  # of several masses, a stable region this much larger than the smallest is not drawn whole
_FAR_OUT = 3.0  # an operating point this much beyond the whole region is named in the legend, not drawn
_MOST_DELAY = 40.0  # sample periods: the poles of a later loop take too long to find all over a picture
_FINE = 0.003  # of the picture: distance between the points of a line
_FEW_POLES = 8
_MOST_DECAY = 16.0  # of a pole, per sample: beyond it rounding decides
_MOST_FOLD_DECAY = 10.0  # of a double pole, per sample: beyond it rounding decides what its neighbour is
_HALVINGS = 14  # of a mesh's side: far less than a dot of the picture

Judge = Callable[[Floats, Floats], Bools]
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

    stiffness: float  # N/m that are drawn as 1
    damping: float  # N·s/m that are drawn as 1
    offset: float  # N·s/m that are added to B: the real friction, where the axis shows the total
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

    def in_units(self, units: Units) -> tuple[float, float]:
        """Returns by what k and b as drawn are multiplied to be in these units: 1 and 1 where they have none."""
        return (1.0, 1.0) if self.normalised else (units.scaled(1.0, "N/m"), units.scaled(1.0, "N·s/m"))

    @property
    def simulated(self) -> str:
        """Name of the quantity on the B axis."""
        return "B + b_0" if self.total else "B"

    @property
    def axis_labels(self) -> tuple[str, str]:
        """Labels of the K axis and of the B axis."""
        stiffness, damping = drawn_in().name("N/m"), drawn_in().name("N·s/m")
        K, B = ("$K\\,T^2/m$", "$B\\,T/m$") if self.normalised else (f"$K$  ({stiffness})", f"$B$  ({damping})")
        total = B.replace("B", f"({self.simulated})" if self.normalised else self.simulated)
        return f"simulated stiffness  {K}", f"total damping  {total}" if self.total else f"simulated damping  {B}"

    @property
    def felt_names(self) -> tuple[str, str]:
        """Names of the felt k and b, with their units."""
        stiffness, damping = drawn_in().name("N/m"), drawn_in().name("N·s/m")
        return ("$k\\,T^2/m$", "$b\\,T/m$") if self.normalised else (f"$k$ ({stiffness})", f"$b$ ({damping})")

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
    larger. `hands`: one, or one for each mass. `from_total`: B begins where B + b0 is 0, otherwise at 0. `K_to` and
    `B_to`: the ends of the axes in N/m and N·s/m, if they are given."""
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
        found = hands[0].units(view.B_to, "N·s/m", "g")
        raise UsageError(f"--to-damping: found {found}, expected more than {view.B_from:g}")
    return view


def _drawn_whole(ends: list[float], otherwise: float) -> float:
    """Returns the largest end, limited so that the smallest stays visible."""
    known = [end for end in ends if math.isfinite(end)]
    return min(max(known), _FAR_LARGER * min(known)) if known else otherwise


@dataclass(frozen=True)
class Curve:
    """A line in the plane, in the axes' units."""

    kind: str
    value: float  # the k or b that it is drawn for; NaN if none
    mass: float  # real mass, kg
    K: Floats
    B: Floats
    k: Floats  # what the hand feels there; NaN if it is not worked out
    b: Floats

    @property
    def is_seen(self) -> bool:
        """True if any of it is in the picture."""
        return bool(np.any(np.isfinite(self.K)))

    def rows(self) -> Iterator[tuple[Any, ...]]:
        """Yields (kind, value, mass, K, B, k, b) of every point."""
        for point in zip(*(column.tolist() for column in (self.K, self.B, self.k, self.b)), strict=True):
            yield self.kind, self.value, self.mass, *point


@dataclass(frozen=True)
class Sheet:
    """The plane on which curves are drawn: a configuration, the part in view, and the units."""

    configuration: Configuration
    view: View
    scale: Scale

    def curve(self, kind: str, value: float, *columns: Floats) -> Curve:
        """Returns a line from K, B and, if known, k and b in SI units, with gaps outside the view."""
        seen = np.where(self.view.holds(*columns[:2]), columns, np.nan)
        return self.outline(kind, value, *seen[:, self._thinned(*seen[:2])])

    def oscillators(self, kind: str, value: float, k: Floats, b: Floats) -> Curve:
        """Returns the line of the K and B that are felt as these k and b (SI units)."""
        K, B = self.configuration.simulated(k, b, dominant=False)
        seen = self.view.holds(K, B)
        # Whether they are felt takes every pole, so only the points that are drawn are asked.
        kept = self._thinned(np.where(seen, K, np.nan), B)
        k, b = k[kept], b[kept]
        K, B = self.configuration.simulated(k, b)
        K = np.where(seen[kept], K, np.nan)
        one_gap = np.isfinite(K) | np.isfinite(np.roll(K, 1))
        return self.outline(kind, value, *(column[one_gap] for column in (K, B, k, b)))

    def outline(self, kind: str, value: float, K: Floats, B: Floats, *felt: Floats) -> Curve:
        """Returns a line from SI units with all its points."""
        k, b = felt or np.full((2, K.size), np.nan)
        drawn = self.scale.of_stiffness(K), self.scale.of_simulated(B)
        return Curve(kind, value, self.configuration.mass, *drawn, self.scale.of_stiffness(k), self.scale.of_damping(b))

    def region(self, kind: str, judge: Judge) -> list[Curve]:
        """Returns the closed outlines of where `judge`, called with K and B in SI units, is true; a hole is one too.

        Traced from point to point of the mesh; then each point is moved along the mesh's side, by bisection.
        """
        K, B = self.mesh()
        inside = judge(K, B)
        if not inside.any():
            return []
        traced = Figure().add_subplot().contourf(inside.astype(float), levels=[0.5, 1.5])
        rings = [np.asarray(ring) for path in traced.get_paths() for ring in path.to_polygons(closed_only=True)]
        return [self.outline(kind, math.nan, *_refined(judge, inside, K[0], B[:, 0], ring)) for ring in rings]

    def mesh(self, coarse: int = 1) -> tuple[Floats, Floats]:
        """Returns (K, B), (rows, columns), SI units, all over the picture: as many as are judged within a second."""
        poles = self.configuration.characteristic(1.0, 1.0).size - 1
        columns, rows = (160, 120) if poles <= _FEW_POLES else (100, 80)
        K = self.view.K_to * np.linspace(1e-6, 1.0, columns // coarse + 1)
        B = np.linspace(self.view.B_from, self.view.B_to, rows // coarse + 1)
        return np.tile(K, (B.size, 1)), np.tile(B[:, None], K.size)

    def _thinned(self, K: Floats, B: Floats) -> NDArray[np.intp]:
        """Returns the indices of a line's points about `_FINE` apart; its ends and its gaps are kept."""
        x, y = K / self.view.K_to, B / (self.view.B_to - self.view.B_from)
        there = np.isfinite(x + y)
        steps = np.nan_to_num(np.abs(np.diff(x)) + np.abs(np.diff(y)))
        moved = np.diff(np.cumsum(np.append(0.0, steps)) // _FINE, prepend=-1.0) > 0.0
        before, after = np.append(False, there[:-1]), np.append(there[1:], False)
        return np.flatnonzero((there & (moved | ~before | ~after)) | (~there & before))


def round_values(last: float, most: int) -> Floats:
    """Returns the multiples of a round step (1, 2 or 5 times a power of ten) up to `last`, at most `most` of them."""
    if not 0.0 < last < math.inf:
        return np.empty(0)
    values = MaxNLocator(most, steps=[1, 2, 5, 10]).tick_values(0.0, last)
    return np.array([float(f"{value:.10g}") for value in values if 0.0 < value <= last * (1.0 + 1e-9)])


def values_felt(sheet: Sheet, most_k: int, most_b: int, units: Units) -> tuple[Floats, Floats]:
    """Returns stiffnesses k and dampings b, as drawn, that are felt in the picture and round in `units`."""
    configuration = sheet.configuration
    K, B = sheet.mesh(coarse=2)
    k, b = configuration.equivalent(K, B)
    seen = np.isfinite(k) & np.isfinite(b) & configuration.is_stable(K, B)
    if not seen.any():
        return np.empty(0), np.empty(0)
    # The largest few are felt in a corner only, and would make the step too coarse for all the rest.
    k_last = sheet.scale.of_stiffness(float(np.quantile(k[seen], 0.98)))
    b_last = sheet.scale.of_damping(float(np.quantile(b[seen], 0.98)))
    k_factor, b_factor = sheet.scale.in_units(units)
    return round_values(k_last * k_factor, most_k) / k_factor, round_values(b_last * b_factor, most_b) / b_factor


def iso_curves(sheet: Sheet, k_values: Floats, b_values: Floats) -> list[Curve]:
    """Returns the curves of equal felt stiffness k, then those of equal felt damping b, for values as drawn."""
    configuration, view = sheet.configuration, sheet.view
    curves = []
    for value in k_values:
        all_b = _denser_up_to(view.B_to, configuration.damping_unit * _MOST_DECAY * np.linspace(0.0, 1.0, 3000) ** 3)
        all_k = np.full(all_b.shape, value * sheet.scale.stiffness)
        curves.append(sheet.oscillators("iso_k", value, all_k, all_b))
    for value in b_values:
        all_k = _denser_up_to(view.K_to, _stiffnesses(configuration, value * sheet.scale.damping))
        all_b = np.full(all_k.shape, value * sheet.scale.damping)
        curves.append(sheet.oscillators("iso_b", value, all_k, all_b))
    return curves


def ideal_curves(sheet: Sheet, k_values: Floats, b_values: Floats) -> list[Curve]:
    """Returns where the same k and b would be felt in continuous time: K = k and B = b, less what the device has."""
    c, view = sheet.configuration, sheet.view
    K_ends, B_ends = np.array([0.0, view.K_to]), np.array([view.B_from, view.B_to])
    K, B = k_values * sheet.scale.stiffness - c.stiffness, b_values * sheet.scale.damping - c.friction
    upright = [
        sheet.curve("ideal_k", value, np.full(2, at if view.shows(at, view.B_from) else np.nan), B_ends)
        for value, at in zip(k_values, K, strict=True)
    ]
    return upright + [
        sheet.curve("ideal_b", value, K_ends, np.full(2, at if view.shows(0.0, at) else np.nan))
        for value, at in zip(b_values, B, strict=True)
    ]


def stability_boundary(sheet: Sheet) -> Curve:
    """Returns the curve b = 0 (§6.2)."""
    k = _denser_up_to(sheet.view.K_to, _stiffnesses(sheet.configuration, 0.0))
    return sheet.oscillators("stability_limit", 0.0, k, np.zeros(k.shape))


def fold(sheet: Sheet) -> Curve:
    """Returns where the map folds: beyond it no spring and damper is equivalent."""
    decay = np.geomspace(1e-5, _MOST_FOLD_DECAY, 6000) * sheet.configuration.rate
    return sheet.curve("fold", math.nan, *sheet.configuration.fold(decay))


def linear_limit(sheet: Sheet) -> Curve:
    """Returns the largest stiffness by the rule for the neighbourhood of the origin."""
    B = np.linspace(sheet.view.B_from, sheet.view.B_to, 400)
    K = np.asarray(sheet.configuration.linear_stiffness_limit(B))
    return sheet.curve("linear_limit", math.nan, np.where(np.isfinite(K), K, np.nan), B)


def passive(sheet: Sheet) -> Curve:
    """Returns the outline of the passive walls: on its border the device's friction just suffices.

    The friction needed grows in proportion to the wall, so each direction has one such wall. ValueError where the
    condition is not derived for this configuration."""
    view, configuration = sheet.view, sheet.configuration
    angle = np.linspace(-0.5 * np.pi if view.B_from < 0.0 else 0.0, 0.5 * np.pi, 361)
    K, B = 2.0 * configuration.rate * np.cos(angle), np.sin(angle)  # even over where the limit is expected
    size = (configuration.friction or math.nan) / configuration.needed_friction(K, B)
    K, B = np.maximum(K * size, 0.0), B * size
    # Along K = 0 back to where B begins.
    return sheet.outline("passive", math.nan, np.append(K, 0.0 * K[0]), np.append(B, B[0]))


def _stiffnesses(configuration: Configuration, b: float) -> Floats:
    """Returns the stiffnesses, N/m, of oscillators with this damping below the Nyquist frequency; many are small."""
    decay = 0.5 * b / configuration.damping_unit
    return np.asarray(configuration.stiffness_unit * (np.pi**2 + decay**2) * np.linspace(0.0, 1.0, 4000) ** 3)


def _denser_up_to(end: float, values: Floats) -> Floats:
    """Adds values where the picture is, which may show a small part of all that can be felt."""
    shown = np.linspace(0.0, 2.0 * end, 600)
    return np.unique(np.concatenate([values, shown[shown < values[-1]]]))


def _refined(judge: Judge, inside: Bools, along_K: Floats, along_B: Floats, ring: Floats) -> tuple[Floats, Floats]:
    """Moves the points of a ring of mesh indices to where the judgement changes."""
    low, high = np.floor(ring).astype(int).T, np.ceil(ring).astype(int).T
    at_low = inside[low[1], low[0]]
    yes, no = np.where(at_low, low, high), np.where(at_low, high, low)
    (K_yes, B_yes), (K_no, B_no) = (np.array([along_K[at[0]], along_B[at[1]]]) for at in (yes, no))
    for _ in range(_HALVINGS):
        K, B = 0.5 * (K_yes + K_no), 0.5 * (B_yes + B_no)
        here = judge(K, B)
        K_yes, B_yes = np.where(here, K, K_yes), np.where(here, B, B_yes)
        K_no, B_no = np.where(here, K_no, K), np.where(here, B_no, B)
    return K_yes, B_yes
