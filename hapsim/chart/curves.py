"""The curves of the K,B plane (Florens et al., §5 and Figures 7 to 9), in SI units.

Each is a line of points; where it means nothing, and outside of the part that is looked at, its points are NaN.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hapsim.chart.region import Judge, border
from hapsim.chart.round_numbers import round_values
from hapsim.chart.scale import Scale, thinned
from hapsim.chart.view import View
from hapsim.theory import Configuration
from hapsim.theory.arrays import Floats

_FINE = 0.003  # of the picture: points of a line are so far apart
_FEW_POLES = 8
_MOST_DECAY = 16.0  # of a pole in a sample: beyond, nothing is left to be seen, and rounding decides
_MOST_FOLD_DECAY = 10.0  # of a double pole: beyond, rounding decides what its neighbour is


@dataclass(frozen=True)
class Curve:
    """A line in the plane, drawn in the axes' units."""

    kind: str
    value: float
    """What it is drawn for: k or b, as drawn; NaN where nothing."""
    mass: float
    """Real mass, kg."""
    K: Floats
    B: Floats
    k: Floats
    """What the hand feels there, as drawn; NaN where nothing is said of it."""
    b: Floats

    @property
    def is_seen(self) -> bool:
        """Whether any of it is in the picture."""
        return bool(np.any(np.isfinite(self.K)))


@dataclass(frozen=True)
class Sheet:
    """What curves are drawn on: whose plane, which part of it, and in which units."""

    configuration: Configuration
    view: View
    scale: Scale

    def curve(
        self, kind: str, value: float, K: Floats, B: Floats, k: Floats | None = None, b: Floats | None = None
    ) -> Curve:
        """A line from SI units, its points no denser than is seen; what the picture does not show becomes a gap."""
        nothing = np.full(K.shape, np.nan)
        k, b = (nothing if given is None else given for given in (k, b))
        seen = self.view.holds(K, B)
        columns = [np.where(seen, column, np.nan) for column in (K, B, k, b)]
        kept = self._thinned(*columns[:2])
        return self.outline(kind, value, *(column[kept] for column in columns))

    def oscillators(self, kind: str, value: float, k: Floats, b: Floats) -> Curve:
        """The line of the K and B that are felt as these k and b, SI units; a gap where none are."""
        K, B = self.configuration.simulated(k, b, dominant=False)
        seen = self.view.holds(K, B)
        # Whether they are felt asks for every pole: it is asked of what is drawn only.
        kept = self._thinned(np.where(seen, K, np.nan), B)
        K, B = self.configuration.simulated(k[kept], b[kept])
        K = np.where(seen[kept], K, np.nan)
        one_gap = np.isfinite(K) | np.isfinite(np.roll(K, 1))
        return self.outline(kind, value, *(column[one_gap] for column in (K, B, k[kept], b[kept])))

    def outline(self, kind: str, value: float, K: Floats, B: Floats, k: Floats, b: Floats) -> Curve:
        """A line from SI units, all its points."""
        of_k, of_b = self.scale.of_stiffness, self.scale.of_damping
        return Curve(kind, value, self.configuration.mass, of_k(K), self.scale.of_simulated(B), of_k(k), of_b(b))

    def region(self, kind: str, judge: Judge) -> list[Curve]:
        """The closed outlines of where `judge`, of K and B in SI units, says yes."""
        rings = border(judge, *self.mesh())
        return [self.outline(kind, math.nan, *ring, *np.full((2, ring[0].size), np.nan)) for ring in rings]

    def mesh(self, coarse: int = 1) -> tuple[Floats, Floats]:
        """(K, B) all over the picture, (rows, columns), SI units: as many as can be judged while a user waits."""
        poles = self.configuration.characteristic(1.0, 1.0).size - 1
        columns, rows = (160, 120) if poles <= _FEW_POLES else (100, 80)
        return self.view.mesh(columns // coarse + 1, rows // coarse + 1)

    def _thinned(self, K: Floats, B: Floats) -> NDArray[np.intp]:
        return thinned(K / self.view.K_to, B / (self.view.B_to - self.view.B_from), _FINE)


def values_felt(sheet: Sheet, most_k: int, most_b: int) -> tuple[Floats, Floats]:
    """Round stiffnesses k and dampings b, as drawn, that are felt in the picture, at most so many."""
    configuration = sheet.configuration
    K, B = sheet.mesh(coarse=2)
    k, b = configuration.equivalent(K, B)
    seen = np.isfinite(k) & np.isfinite(b) & configuration.is_stable(K, B)
    if not seen.any():
        return np.empty(0), np.empty(0)
    # The largest few are felt in a corner only, and would make the step too coarse for all the rest.
    k_last = sheet.scale.of_stiffness(float(np.quantile(k[seen], 0.98)))
    b_last = sheet.scale.of_damping(float(np.quantile(b[seen], 0.98)))
    return round_values(k_last, most_k), round_values(b_last, most_b)


def iso_k(sheet: Sheet, value: float) -> Curve:
    """Where the felt stiffness is `value`, as drawn, whatever the felt damping."""
    unit = sheet.configuration.damping_unit
    u = np.linspace(0.0, 1.0, 3000)
    k, b = value * sheet.scale.stiffness, _also_up_to(sheet.view.B_to, unit * _MOST_DECAY * u**3)
    return sheet.oscillators("iso_k", value, np.full(b.shape, k), b)


def iso_b(sheet: Sheet, value: float) -> Curve:
    """Where the felt damping is `value`, as drawn, whatever the felt stiffness."""
    b = value * sheet.scale.damping
    k = _also_up_to(sheet.view.K_to, _stiffnesses(sheet.configuration, b))
    return sheet.oscillators("iso_b", value, k, np.full(k.shape, b))


def stability_limit(sheet: Sheet) -> Curve:
    """The curve b = 0 (§6.2)."""
    k = _also_up_to(sheet.view.K_to, _stiffnesses(sheet.configuration, 0.0))
    return sheet.oscillators("stability_limit", 0.0, k, np.zeros(k.shape))


def ideal_k(sheet: Sheet, value: float) -> Curve:
    """Where k would be felt if nothing were lost: K = k, less the device's own spring."""
    view = sheet.view
    K_ideal = value * sheet.scale.stiffness - sheet.configuration.stiffness
    K = np.full(2, K_ideal if view.shows(K_ideal, view.B_from) else np.nan)
    return sheet.curve("ideal_k", value, K, np.array([view.B_from, view.B_to]))


def ideal_b(sheet: Sheet, value: float) -> Curve:
    """Where b would be felt if nothing were lost: B = b, less the device's own friction."""
    view = sheet.view
    B = value * sheet.scale.damping - sheet.configuration.friction
    B = B if view.B_from <= B <= view.B_to else np.nan
    return sheet.curve("ideal_b", value, np.array([0.0, view.K_to]), np.full(2, B))


def fold(sheet: Sheet) -> Curve:
    """Where the map folds: on the far side no spring and damper is equivalent."""
    decay = np.geomspace(1e-5, _MOST_FOLD_DECAY, 6000) * sheet.configuration.rate
    K, B, k, b = sheet.configuration.fold(decay)
    return sheet.curve("fold", math.nan, K, B, k, b)


def linear_limit(sheet: Sheet) -> Curve:
    """The most stiffness by the rule for the neighbourhood of the origin."""
    view = sheet.view
    B = np.linspace(view.B_from, view.B_to, 400)
    K = np.asarray(sheet.configuration.linear_stiffness_limit(B))
    return sheet.curve("linear_limit", math.nan, np.where(np.isfinite(K), K, np.nan), B)


def passive(sheet: Sheet) -> Curve:
    """The outline of the passive walls: its border needs just the friction that the device has.

    The friction needed grows in proportion to the wall, so that along each direction one wall needs what there is.

    Raises:
        ValueError: the condition is not derived.
    """
    view, configuration = sheet.view, sheet.configuration
    angle = np.linspace(-0.5 * np.pi if view.B_from < 0.0 else 0.0, 0.5 * np.pi, 361)
    # Directions evenly spread over where the limit is expected.
    K, B = 2.0 * configuration.rate * np.cos(angle), np.sin(angle)
    size = (configuration.friction or math.nan) / configuration.needed_friction(K, B)
    K, B = np.maximum(K * size, 0.0), B * size
    # Along K = 0 back to where B begins.
    K, B = np.append(K, 0.0 * K[0]), np.append(B, B[0])
    return sheet.outline("passive", math.nan, K, B, *np.full((2, K.size), np.nan))


def _stiffnesses(configuration: Configuration, b: float) -> Floats:
    """All that an oscillator of this damping can have below the Nyquist frequency, N/m; many of them small."""
    decay = 0.5 * b / configuration.damping_unit
    u = np.linspace(0.0, 1.0, 4000)
    return np.asarray(configuration.stiffness_unit * (np.pi**2 + decay**2) * u**3)


def _also_up_to(end: float, values: Floats) -> Floats:
    """With more of them where the picture is: it may show a small part of all that can be felt."""
    shown = np.linspace(0.0, 2.0 * end, 600)
    return np.unique(np.concatenate([values, shown[shown < values[-1]]]))


def joined(curves: list[Curve]) -> dict[str, list[object]]:
    """Every point of every curve, long: a name, what it is drawn for, the mass, and K, B, k, b as drawn."""
    columns: dict[str, list[object]] = {name: [] for name in ("curve", "value", "mass_kg", "K", "B", "k", "b")}
    for curve in curves:
        if curve.is_seen:
            columns["curve"] += [curve.kind] * curve.K.size
            columns["value"] += [curve.value] * curve.K.size
            columns["mass_kg"] += [curve.mass] * curve.K.size
            for name in ("K", "B", "k", "b"):
                columns[name] += getattr(curve, name).tolist()
    return columns


def renamed(columns: dict[str, list[object]], scale: Scale) -> dict[str, list[object]]:
    """The same columns with the axes' units in their names."""
    names = dict(zip(("K", "B", "k", "b"), scale.columns, strict=True))
    return {names.get(name, name): values for name, values in columns.items()}
