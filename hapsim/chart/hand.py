"""The hand of which a picture is drawn: a hand of a scene, or one that the command line describes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from hapsim.chart.round_numbers import short
from hapsim.errors import UsageError
from hapsim.prediction import predict
from hapsim.scene import Scene
from hapsim.theory import Configuration, frequency_and_ratio


@dataclass(frozen=True)
class Hand:
    """A temporary hybrid system (Florens et al., §4), and what is simulated for it."""

    name: str
    channel: int | None
    """None where it stands in no scene."""
    configuration: Configuration
    stiffness: float
    """K, N/m, simulated; NaN where none is."""
    damping: float
    """B, N·s/m, simulated; NaN where none is."""
    masses: tuple[float, ...] = ()
    """kg: the least, the middle and the most that the hand may have, where the scene knows no more."""

    @property
    def is_simulated(self) -> bool:
        """Whether there is an operating point."""
        return math.isfinite(self.stiffness) and math.isfinite(self.damping)

    def with_mass(self, mass: float) -> Hand:
        """The same with another mass, kg."""
        return replace(self, configuration=replace(self.configuration, mass=mass))

    def with_simulated(self, stiffness: float | None, damping: float | None) -> Hand:
        """The same with another K, N/m, or B, N·s/m, simulated for it; a spring alone has no damping."""
        if stiffness is None and damping is None:
            return self
        for name, value in (("stiffness", stiffness), ("damping", damping)):
            if value is not None and not math.isfinite(value):
                raise UsageError(f"--simulated-{name}: found {value:g}, expected a finite number")
        K, B = (self.stiffness, self.damping) if self.is_simulated else (0.0, 0.0)
        return replace(self, stiffness=K if stiffness is None else stiffness, damping=B if damping is None else damping)

    def felt(self) -> tuple[float, float]:
        """(k, b) in N/m and N·s/m; NaN where no spring and damper is equivalent."""
        k, b = self.configuration.equivalent(self.stiffness, self.damping)
        return float(k) + 0.0, float(b) + 0.0  # no -0

    def eigenfrequency(self) -> float:
        """sqrt(k/m)/2 pi, Hz, of what is felt; NaN where there is none."""
        k, b = self.felt()
        return float(frequency_and_ratio(self.configuration.mass, k, b)[0]) if k > 0 else math.nan

    def summary(self) -> dict[str, Any]:
        """What a script would want to know of it, SI units."""
        c = self.configuration
        k, b = self.felt()
        limits = {
            "stable_stiffness": c.stable_stiffness(self.damping),
            "stable_damping": c.stable_damping(self.stiffness),
        }
        return {
            "name": self.name,
            "channel": self.channel,
            "mass": c.mass,
            "friction": c.friction,
            "stiffness": self.stiffness,
            "damping": self.damping,
            "k": k,
            "b": b,
            "frequency_hz": self.eigenfrequency(),
            "dominant": math.isfinite(k) and math.isfinite(b),
            "stable": bool(c.is_stable(self.stiffness, self.damping)) if self.is_simulated else None,
            **{name: [float(end) for end in ends] for name, ends in limits.items()},
        }


def described(configuration: Configuration, *, mass: bool = True, normalised: bool = False) -> str:
    """One line for a title: what is simulated with, in SI units or the paper's. `mass`: whether it is named."""
    c = configuration
    parts = []
    if not normalised:
        parts += ([f"$m$ = {short(c.mass)} kg"] if mass else []) + [f"{short(c.rate)} Hz"]
    parts += [f"{c.hold} hold", f"delay {c.delay:g}"]
    if c.sampling != "ideal":
        parts.append(f"sampling: {c.sampling}")
    if c.damper != "backward":
        parts.append(f"damper: {c.damper}" + (f", {c.cutoff:g} Hz" if c.cutoff else ""))
    real = {
        "b_0": (c.friction, "N·s/m", "T/m", c.damping_unit),
        "k_0": (c.stiffness, "N/m", "T^2/m", c.stiffness_unit),
    }
    for symbol, (value, unit, normal, one) in real.items():
        if value:
            words = (
                f"${symbol} {normal}$ = {short(value / one)}" if normalised else f"${symbol}$ = {short(value)} {unit}"
            )
            parts.append(words)
    return ", ".join(parts)


def hands_of_scene(scene: Scene, given: Mapping[str, Any]) -> list[Hand]:
    """The lone hands of a scene, in its order; `given`: fields of a Configuration that are to be other than it says."""
    prediction = predict(scene, with_margins=False)
    if any(one.predictor is not None for one in prediction.felt):
        raise UsageError(
            f"device.correction: found {scene.device.correction}, of which this picture does not show the loop; "
            "expected none or poles. `hapsim chart felt` and `hapsim measure --impedance` show what a predictor does"
        )
    felt = prediction.felt
    if not felt:
        why = "; ".join(f"{name} {words}" for name, words in prediction.coupled.items())
        raise UsageError(
            f"a hand is drawn that is a spring and damper's alone, but {why}. `hapsim check` lists the whole's modes"
        )
    spans = scene.device.mass_spans(scene.channels)
    return [
        Hand(
            one.name,
            one.channel,
            configured(one.configuration, given),
            one.stiffness,
            one.damping,
            _masses(*spans[one.channel]),
        )
        for one in felt
    ]


def _masses(least: float, most: float) -> tuple[float, ...]:
    return (least, math.sqrt(least * most), most) if least < most else ()


def hand_of_options(given: Mapping[str, Any]) -> Hand:
    """A hand that stands in no scene; `given`: fields of a Configuration."""
    for name in ("mass", "rate"):
        if name not in given:
            raise UsageError(f"--{name} is missing: without a SCENE, --mass and --rate describe the hand")
    return Hand("hand", None, configured(None, given), math.nan, math.nan)


def configured(configuration: Configuration | None, given: Mapping[str, Any]) -> Configuration:
    """A Configuration with some fields given; UsageError where they do not fit."""
    try:
        return Configuration(**given) if configuration is None else replace(configuration, **_complete(given))
    except ValueError as error:
        raise UsageError(f"--{error}") from None


def _complete(given: Mapping[str, Any]) -> dict[str, Any]:
    """Another damper has another cutoff, or none."""
    return ({"cutoff": None} if "damper" in given else {}) | dict(given)
