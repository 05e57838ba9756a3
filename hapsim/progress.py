"""How a run is doing, for whatever shows it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

_SHORTEST_S = 0.25  # in less, a few positions that came together make a rate of their own


@dataclass(frozen=True)
class Progress:
    """How a run is doing, for a live line. Tuples have an entry for each channel."""

    phase: Literal["compiling", "running", "ended", "waiting", "serving"]
    text: str = ""
    share: float | None = None
    """How far it is, 0 to 1, where that is known."""
    elapsed_s: float = 0.0
    rate_hz: float = 0.0
    force: tuple[float, ...] = ()
    """N."""
    position: tuple[float, ...] = ()
    """m."""
    age_samples: int = 0
    deadline_misses: int = 0
    limited_ticks: int = 0
    ticks: int = 0
    estimated_mass_kg: tuple[float | None, ...] = ()
    """With a correction that adapts; None on other channels."""
    estimated_mass_uncertainty_kg: tuple[float | None, ...] = ()
    """Standard uncertainty; the whole span where nothing is known."""
    mass_explained: tuple[float | None, ...] = ()
    """R²: the share of the motion that the forces explain."""
    mass_age_s: tuple[float | None, ...] = ()
    """Seconds since the motion last showed the mass."""
    slewed_ticks: int = 0
    faded_ticks: int = 0
    sensor_tests: int = 0
    frozen_ticks: int = 0
    frozen: str = ""
    """What is said of a position that stands still while force acts, as long as it does; the rest as in a Report."""
    slowed_ticks: int = 0
    """Ticks in which a change of the scene was slowed, for want of energy."""
    sound_frames: int = 0
    """Of the scene's sound, where it is played or written; the rest as in a Report."""
    clipped_sound_values: int = 0
    lost_sound_frames: int = 0
    underruns: int = 0
    resampling_ppm: float | None = None
    sound_latency_s: tuple[float, float] | None = None

    @property
    def seen_rate_hz(self) -> float | None:
        """The rate, once it is one of more than a few milliseconds."""
        return self.rate_hz if self.elapsed_s >= _SHORTEST_S else None
