"""The pulses that a program can ask for: their shapes, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hapsim.errors import UsageError
from hapsim.number_format import duration
from hapsim.running.live_parameters import is_number, shown
from hapsim.scene import Scene
from hapsim.scene.issue import did_you_mean, one_of

LONGEST_S = 5.0
LEAST_SAMPLES = 4
"""Samples of a period of a buzz, at least."""
_DECAY = 5.0  # time constants of a knock


def _click(s: float, _periods: float) -> float:
    return math.sin(math.pi * s)


def _knock(s: float, _periods: float) -> float:
    return (math.exp(-_DECAY * s) - math.exp(-_DECAY)) / (1.0 - math.exp(-_DECAY))


def _buzz(s: float, periods: float) -> float:
    u = min(min(s, 1.0 - s) * max(periods, 2.0), 1.0)
    return u * u * (3.0 - 2.0 * u) * math.sin(2.0 * math.pi * periods * s)


SHAPES: dict[str, Callable[[float, float], float]] = {"click": _click, "knock": _knock, "buzz": _buzz}
"""Share of the largest force over the completed share of the time, and the number of periods.

A click is half a sine. A knock begins at once and decays with a fifth of its time. A buzz is a sine that fades in over
its first period and out over its last."""


@dataclass(frozen=True)
class Pulse:
    """A pulse of force on a channel."""

    channel: int
    shape: str
    """One of `SHAPES`."""
    force: float
    """Largest force, N (N·m on a rotary channel); its sign is the direction."""
    seconds: float
    periods: float | None = None
    """Periods of a buzz."""

    def forces(self, rate: float) -> list[float]:
        """Returns the force of each sample at `rate` Hz, N, each for the middle of its sample."""
        count, shape = round(self.seconds * rate), SHAPES[self.shape]
        return [self.force * shape((k + 0.5) / count, self.periods or 0.0) for k in range(count)]

    def describe(self, scene: Scene) -> str:
        """Returns the pulse in words."""
        periods = f", {self.periods:g} periods" if self.periods else ""
        force = scene.units_of(self.channel)(self.force, "N", "g")
        return f"{self.shape} of {force} for {duration(self.seconds)}{periods} on channel {self.channel}"


def require_possible(pulse: Pulse, scene: Scene, limits: Sequence[float]) -> None:
    """Raises UsageError for a pulse that no loop of `scene` renders. `limits`: the device's, N."""
    for key, value in (("force", pulse.force), ("seconds", pulse.seconds), ("periods", pulse.periods)):
        if not is_number(value) and (key, value) != ("periods", None):
            raise UsageError(f"{key}: found {shown(value)}, expected a number")
    is_whole = is_number(pulse.channel) and isinstance(pulse.channel, int)
    if not is_whole or not 0 <= pulse.channel < scene.channels:
        found = f"found {shown(pulse.channel)}"
        raise UsageError(f"channel: {found}, expected one of the scene's channels, 0 to {scene.channels - 1}")
    if not isinstance(pulse.shape, str) or pulse.shape not in SHAPES:
        near = did_you_mean(str(pulse.shape), SHAPES)
        raise UsageError(f"shape: found {shown(pulse.shape)}, expected {one_of(SHAPES)}{near}")
    limit = min(scene.device.force_limit, limits[pulse.channel])
    if not abs(pulse.force) <= limit:  # NaN too
        most = scene.units_of(pulse.channel)(limit, "N", "g")
        raise UsageError(f"force: found {pulse.force:g}, expected at most the force limit, {most} either way")
    if not 1.0 / scene.rate <= pulse.seconds <= LONGEST_S:
        span = f"{1.0 / scene.rate:g} (a sample) to {LONGEST_S:g}"
        raise UsageError(f"seconds: found {pulse.seconds:g}, expected {span}")
    if (pulse.shape == "buzz") != (pulse.periods is not None):
        found = "no periods" if pulse.periods is None else f"{pulse.periods:g}"
        raise UsageError(f"periods: found {found} of a {pulse.shape}, expected them of a buzz, and of no other shape")
    most_periods = pulse.seconds * scene.rate / LEAST_SAMPLES
    if pulse.periods is not None and not 1.0 <= pulse.periods <= most_periods:
        expected = f"expected 1 to {most_periods:g}, so that a period has {LEAST_SAMPLES} samples at least"
        raise UsageError(f"periods: found {pulse.periods:g}, {expected}")
