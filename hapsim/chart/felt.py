"""What a hand feels of what a scene asks for, with every correction: the plane of desired stiffness and damping ratio.

Worked out by theory alone. The desired K T²/m has a logarithmic axis, the desired damping ratio a linear one, and every
point of that plane counts alike.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum
from typing import Any

import numpy as np

from hapsim.chart.hand import Hand
from hapsim.prediction.correction import CORRECTIONS, felt_error
from hapsim.prediction.correction.kind import Observer
from hapsim.prediction.correction.predictor import pole_of_push
from hapsim.theory import Configuration
from hapsim.theory.arrays import Bools, Floats

DRAWN = ("none", "poles", "predictor")
"""Of `device.correction`; an adaptive one that knows its mass is a predictor."""
WITHIN = (0.01, 0.05, 0.1)
OF_SHARES = 0.05
"""The felt error within which a point counts in the curves."""

_LEAST, _MOST, _MOST_RATIO = 1e-4, 2.0, 1.5
_POINTS, _POINTS_OF_A_SHARE = (144, 72), (60, 30)
_CLOSE = np.array([1.005, 1.01, 1.02, 1.03, 1.045, 1.065, 1.1, 1.15, 1.22, 1.3, 1.4, 1.5, 1.65, 1.8, 2.0])
_MASSES = np.concatenate([1.0 / _CLOSE[::-1], [1.0], _CLOSE])
_DELAYS = np.linspace(0.0, 3.0, 13)
_ON_THE_CIRCLE = 1e-9
_COLUMNS = (
    "panel",
    "correction",
    "K_T2_per_m",
    "damping_ratio",
    "mass_ratio",
    "delay_samples",
    "error_or_share",
    "outcome",
)


class Outcome(IntEnum):
    """What becomes of a desired (k, b)."""

    WITHIN_1 = 0
    WITHIN_5 = 1
    WITHIN_10 = 2
    FURTHER_OFF = 3
    OUT_OF_REACH = 4
    """No (K, B) is felt so: what comes nearest is simulated. It counts as further off than 10 %."""
    UNSTABLE = 5
    NOT_ASKED = 6
    """The device itself has more friction, or more of a spring. It does not count."""


@dataclass(frozen=True)
class Plane:
    """What is asked for: the middles of equal cells."""

    kappa: Floats
    """(n,): K T²/m, what is real included."""
    ratio: Floats
    """(m,): damping ratio, what is real included."""

    def desired(self, configuration: Configuration) -> tuple[Floats, Floats]:
        """(k, b), (n, m), in N/m and N·s/m."""
        k = self.kappa[:, None] * configuration.stiffness_unit + 0.0 * self.ratio
        return k, 2.0 * self.ratio * np.sqrt(k * configuration.mass)


@dataclass(frozen=True)
class Felt:
    """What one correction makes of a plane."""

    error: Floats
    """(n, m): as of ``felt_error``; infinite where no spring and damper is equivalent, or none is had."""
    outcome: Any
    """(n, m), of Outcome."""

    def share(self, within: float) -> float:
        """The part of what can be asked for that is felt within so much."""
        asked = self.outcome != Outcome.NOT_ASKED
        return float(np.mean(self.error[asked] <= within)) if asked.any() else float("nan")


@dataclass(frozen=True)
class FeltChart:
    """The picture's numbers; corrections by their names."""

    hand: Hand
    plane: Plane
    felt: dict[str, Felt]
    mass_ratio: Floats
    """True mass over the declared one."""
    against_mass: dict[str, Floats]
    """Shares within OF_SHARES."""
    delay: Floats
    """Samples."""
    against_delay: dict[str, Floats]
    limit: float
    """The share that any controller could have felt: what swings below half the rate."""

    @property
    def operating_point(self) -> tuple[float, float] | None:
        """(K T²/m, damping ratio) of what the scene asks for; None where it asks for no spring."""
        c = self.hand.configuration
        k, b = self.hand.stiffness + c.stiffness, self.hand.damping + c.friction
        return (k / c.stiffness_unit, b / (2.0 * np.sqrt(k * c.mass))) if k > 0.0 else None

    def columns(self) -> dict[str, list[Any]]:
        """What is drawn, by the names that a data file uses: a row a number."""
        rows: list[tuple[Any, ...]] = []
        blank = ""
        for name, felt in self.felt.items():
            for (i, j), error in np.ndenumerate(felt.error):
                outcome = Outcome(felt.outcome[i, j]).name.lower()
                rows.append(("plane", name, self.plane.kappa[i], self.plane.ratio[j], blank, blank, error, outcome))
        for name in self.felt:
            for mass, share in zip(self.mass_ratio, self.against_mass[name], strict=True):
                rows.append(("mass", name, blank, blank, mass, blank, share, blank))
            for delay, share in zip(self.delay, self.against_delay[name], strict=True):
                rows.append(("delay", name, blank, blank, blank, delay, share, blank))
        return dict(zip(_COLUMNS, map(list, zip(*rows, strict=True)), strict=True))

    def summary(self) -> dict[str, Any]:
        """What a script would want to know."""
        return {
            "share": {
                name: {f"{within:g}": felt.share(within) for within in WITHIN} for name, felt in self.felt.items()
            },
            "out_of_reach": {
                name: float(np.mean(felt.outcome == Outcome.OUT_OF_REACH)) for name, felt in self.felt.items()
            },
            "limit": self.limit,
            "against_mass": {"mass_ratio": self.mass_ratio, **self.against_mass},
            "against_delay": {"delay_samples": self.delay, **self.against_delay},
        }


def felt_chart(hand: Hand) -> FeltChart:
    """What a hand feels of the plane, and how that share goes with its true mass and with the delay."""
    declared = hand.configuration
    plane, coarse = _plane(*_POINTS), _plane(*_POINTS_OF_A_SHARE)
    true = [replace(declared, mass=declared.mass * ratio) for ratio in _MASSES]
    late = [replace(declared, delay=delay) for delay in _DELAYS]
    return FeltChart(
        hand=hand,
        plane=plane,
        felt={name: felt_by(name, declared, declared, plane) for name in DRAWN},
        mass_ratio=_MASSES,
        against_mass={
            name: np.array([felt_by(name, declared, one, coarse).share(OF_SHARES) for one in true]) for name in DRAWN
        },
        delay=_DELAYS,
        against_delay={
            name: np.array([felt_by(name, one, one, coarse).share(OF_SHARES) for one in late]) for name in DRAWN
        },
        limit=limit_of(declared, plane),
    )


def felt_by(correction: str, declared: Configuration, true: Configuration, plane: Plane) -> Felt:
    """What a device that is ``declared``, and has another mass in truth, makes of the plane with a correction.

    The plane is that of the declared mass.
    """
    k, b = plane.desired(declared)
    asked = (k >= declared.stiffness) & (b >= declared.friction)
    kind = CORRECTIONS.get(correction)
    K, B = k - declared.stiffness, b - declared.friction
    if kind is not None:
        K, B = kind.seen_by_theory(declared).simulated(k, b)
    had = asked & np.isfinite(K) & np.isfinite(B)
    error, radius = np.full(k.shape, np.inf), np.zeros(k.shape)
    poles = pole_of_push(declared, k, b)
    for pole in np.unique(poles):
        cells = had & (poles == pole)
        observer = Observer(float(pole), static=k[cells] - declared.stiffness)
        loop = true if kind is None else kind.closed(true, declared, observer)
        radius[cells] = np.abs(loop.poles(K[cells], B[cells])[..., 0])
        error[cells] = felt_error(loop.equivalent(K[cells], B[cells]), (k[cells], b[cells]), true.mass)
    return Felt(error, _outcome(error, radius, asked, had))


def _outcome(error: Floats, radius: Floats, asked: Bools, had: Bools) -> Any:
    within = np.searchsorted(WITHIN, error)
    conditions = [~asked, ~had, radius > 1.0 + _ON_THE_CIRCLE]
    return np.select(conditions, [Outcome.NOT_ASKED, Outcome.OUT_OF_REACH, Outcome.UNSTABLE], within)


def _plane(columns: int, rows: int) -> Plane:
    along = (np.arange(columns) + 0.5) / columns
    return Plane(_LEAST * (_MOST / _LEAST) ** along, _MOST_RATIO * (np.arange(rows) + 0.5) / rows)


def limit_of(declared: Configuration, plane: Plane) -> float:
    """The share of the plane that any controller could have felt.

    A motion that swings at half the rate or above looks like a slower one in its samples: nobody can tell them
    apart, so nobody can have it felt."""
    k, b = plane.desired(declared)
    asked = (k >= declared.stiffness) & (b >= declared.friction)
    swing = np.sqrt(np.maximum(k / declared.mass - (0.5 * b / declared.mass) ** 2, 0.0))
    return float(np.mean(swing[asked] < np.pi * declared.rate)) if asked.any() else float("nan")
