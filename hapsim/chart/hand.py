"""The hand that a picture is drawn for: one of a scene, or one that options describe."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from hapsim.chart.figure import drawn_in
from hapsim.errors import UsageError
from hapsim.number_format import duration, short
from hapsim.prediction import predict
from hapsim.scene import Scene
from hapsim.theory import Configuration, frequency_and_ratio
from hapsim.units import LINEAR, Units


@dataclass(frozen=True)
class Hand:
    """A temporary hybrid system (Florens et al., §4), and the element simulated for it."""

    name: str
    channel: int | None  # None without a scene
    configuration: Configuration
    stiffness: float  # simulated K, N/m; NaN if none is
    damping: float  # simulated B, N·s/m; NaN if none is
    masses: tuple[float, ...] = ()
    """kg: the least, the middle and the largest, if the scene gives a span."""
    corrected: tuple[float, float] | None = None
    """The scene's stiffness and damping, N/m and N·s/m, if a correction simulates others."""
    units: Units = LINEAR
    """Units of its channel."""

    @property
    def is_simulated(self) -> bool:
        """True if there is an operating point."""
        return math.isfinite(self.stiffness) and math.isfinite(self.damping)

    @property
    def desired(self) -> tuple[float, float]:
        """The scene's stiffness and damping, N/m and N·s/m, without the device's own."""
        return self.corrected or (self.stiffness, self.damping)

    def with_mass(self, mass: float) -> Hand:
        """Returns the same hand with another mass, kg."""
        return replace(self, configuration=configured(self.configuration, {"mass": mass}))

    def with_simulated(self, stiffness: float | None, damping: float | None) -> Hand:
        """Returns the same hand with another simulated K, N/m, or B, N·s/m; a spring alone has no damping."""
        given: dict[str, Any] = {
            name: v for name, v in (("stiffness", stiffness), ("damping", damping)) if v is not None
        }
        for name, value in given.items():
            if not math.isfinite(value):
                raise UsageError(f"--simulated-{name}: found {value:g}, expected a finite number")
        before: dict[str, Any] = {} if self.is_simulated else {"stiffness": 0.0, "damping": 0.0}
        return replace(self, corrected=None, **before | given) if given else self

    def felt(self) -> tuple[float, float]:
        """Returns (k, b) in N/m and N·s/m; NaN if no spring and damper is equivalent."""
        k, b = self.configuration.equivalent(self.stiffness, self.damping)
        return float(k) + 0.0, float(b) + 0.0  # no -0

    def eigenfrequency(self) -> float:
        """Returns the felt eigenfrequency sqrt(k/m)/2 pi, Hz; NaN if there is none."""
        k, b = self.felt()
        return float(frequency_and_ratio(self.configuration.mass, k, b)[0]) if k > 0 else math.nan

    def summary(self) -> dict[str, Any]:
        """Returns what scripts read, in SI units."""
        c, (k, b) = self.configuration, self.felt()
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
            "deformation": c.deformation(self.stiffness, self.damping),
            "dominant": math.isfinite(k) and math.isfinite(b),
            "stable": bool(c.is_stable(self.stiffness, self.damping)) if self.is_simulated else None,
            "stable_stiffness": [float(end) for end in c.stable_stiffness(self.damping)],
            "stable_damping": [float(end) for end in c.stable_damping(self.stiffness)],
        }


def described(
    configuration: Configuration, *, mass: bool = True, normalised: bool = False, units: Units | None = None
) -> str:
    """Returns a configuration in one line for a title, in the paper's units or in `units` [default: those of the figure
    that is drawn]; its drive in another line. `mass`: whether to name it."""
    c, units = configuration, units or drawn_in()
    b0, k0 = f"$b_0$ = {units(c.friction, 'N·s/m', short)}", f"$k_0$ = {units(c.stiffness, 'N/m', short)}"
    if normalised:
        b0 = f"$b_0 T/m$ = {short(c.friction / c.damping_unit)}"
        k0 = f"$k_0 T^2/m$ = {short(c.stiffness / c.stiffness_unit)}"
    parts = {
        f"$m$ = {units(c.mass, 'kg', short)}": mass and not normalised,
        f"{short(c.rate)} Hz": not normalised,
        f"{c.hold} hold, delay {c.delay:g}": c.steps == 1,
        f"law on the board, delay {c.delay:g}, window {c.window}": c.steps > 1,
        f"sampling: {c.sampling}": c.sampling != "ideal",
        f"damper: {c.damper}{f', {c.cutoff:g} Hz' if c.cutoff else ''}": c.damper != "backward",
        b0: c.friction,
        k0: c.stiffness,
    }
    drive = {
        f"motor of {units(c.drive.motor_mass, 'kg', short)} on a belt of {units(c.drive.stiffness, 'N/m', short)}, "
        f"{'handle' if c.drive.reads_handle else 'motor'} sensed": c.drive.is_elastic,
        f"motor lag {duration(c.drive.lag)}": c.drive.lag,
    }
    lines = (", ".join(words for words, shown in each.items() if shown) for each in (parts, drive))
    return "\n".join(line for line in lines if line)


def hands_of_scene(scene: Scene, given: Mapping[str, Any]) -> list[Hand]:
    """Returns a scene's hands whose links all end on grounds, in its order.

    `given`: fields of a Configuration that replace the scene's. Raises UsageError if there is no such hand, or if the
    scene's correction is one that these pictures do not show.
    """
    scene.require_line("a hand is drawn that feels one spring and damper. `hapsim chart force` draws the plane")
    prediction = predict(scene, with_margins=False)
    drawn = [(part, part.hand) for part in prediction.parts if part.hand]
    if any(one.predictor is not None for _, one in drawn):
        raise UsageError(
            f"device.correction: found {scene.device.correction}, of which this picture does not show the loop; "
            "expected none or poles. `hapsim chart felt` and `hapsim measure --impedance` show what a predictor does"
        )
    if not drawn:
        why = "; ".join(f"{name} {words}" for name, words in prediction.coupled.items())
        raise UsageError(
            f"a hand is drawn that is a spring and damper's alone, but {why}. `hapsim check` lists the whole's modes"
        )
    hands = []
    for part, one in drawn:
        (least, most), c = scene.device.mass_spans(scene.channels)[one.channel], one.configuration
        masses = (least, math.sqrt(least * most), most) if least < most else ()
        k, b = part.asked
        corrected = None if prediction.rendering is None else (k - c.stiffness, b - c.friction)
        simulated = one.stiffness, one.damping
        hands.append(
            Hand(
                one.name, one.channel, configured(c, given), *simulated, masses, corrected, scene.units_of(one.channel)
            )
        )
    return hands


def hand_of_options(given: Mapping[str, Any]) -> Hand:
    """Returns a hand without a scene. `given`: fields of a Configuration."""
    for name in ("mass", "rate"):
        if name not in given:
            raise UsageError(f"--{name} is missing: without a SCENE, --mass and --rate describe the hand")
    return Hand("hand", None, configured(None, given), math.nan, math.nan)


_OF_LOOP = {"rate", "delay", "hold", "sampling", "damper", "cutoff"}


def configured(configuration: Configuration | None, given: Mapping[str, Any]) -> Configuration:
    """Returns a Configuration with some fields given; raises UsageError if they do not fit."""
    if configuration is not None and configuration.steps > 1 and (other := _OF_LOOP & given.keys()):
        raise UsageError(
            f"--{min(other)}: found a scene with device.law: board, whose loop is the board's; expected none"
        )
    try:
        if configuration is None:
            return Configuration(**given)
        # Another damper has another cutoff, or none.
        return replace(configuration, **(({"cutoff": None} if "damper" in given else {}) | dict(given)))
    except ValueError as error:
        raise UsageError(f"--{error}") from None
