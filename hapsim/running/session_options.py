"""How a session runs: its options, and the forces that may be added to the scene's."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapsim.loop.counts import Progress

if TYPE_CHECKING:  # measuring has an Excitation without a device or a loop
    from hapsim.device.open_connection import Between, TransportKind


@dataclass(frozen=True)
class Guide:
    """Where a hand is led before it is pushed, and how: `hapsim.loop.guide` describes it."""

    target: float
    """m, from the scene's position 0."""
    stiffness: float
    """N/m, of the spring that leads it."""
    beyond: float = 0.0
    """m, how far it goes beyond the target before."""
    seconds: tuple[float, float, float, float] = (2.0, 1.0, 0.25, 0.25)
    """Of the way there, of settling, of the mean and of the crossfade."""

    def ticks(self, rate_hz: float) -> tuple[int, ...]:
        """Of each of these at this rate."""
        return tuple(max(1, round(one * rate_hz)) for one in self.seconds)


@dataclass(frozen=True)
class Excitation:
    """Pushes on one channel, each of `ticks` samples, every `every` samples from sample `start` on.

    Their sign alternates, and their sizes range from `force` (N) down to half of it, each different. They pass the
    guards like any force. `first`: one push at the very beginning, too. `guide`: what leads the hand to a place before
    all this; samples count from the tick on at which it has."""

    channel: int
    force: float
    ticks: int
    every: int
    start: int
    first: bool
    guide: Guide | None = None

    def ticks_before(self, rate_hz: float) -> int:
        """How many ticks the guide takes."""
        return 0 if self.guide is None else sum(self.guide.ticks(rate_hz))


@dataclass(frozen=True, eq=False)
class PeriodicExcitation:
    """A periodic force on one channel: (N,) forces in N, one per sample.

    Sample n, by the device's count, has `forces[n % N]`, whether or not positions were lost. The forces pass the
    guards like any force."""

    channel: int
    forces: NDArray[np.float64]

    def __post_init__(self) -> None:
        forces = np.ascontiguousarray(self.forces, dtype=np.float64)
        if forces.ndim != 1 or forces.size == 0 or not np.all(np.isfinite(forces)):
            raise ValueError(f"forces: found shape {forces.shape}, expected finite numbers in one row")
        object.__setattr__(self, "forces", forces)


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """The options of a session: the keyword parameters of `start`, which describes them."""

    duration: float | None = None
    transport: TransportKind = "auto"
    excitation: Excitation | PeriodicExcitation | None = None
    keep: bool = True
    record: str | Path | None = None
    reports: str | Path | None = None
    realtime: bool = False
    portable: bool = False
    between: Between | None = None
    unstable: bool | None = None
    judges_energy: bool = False
    judges_sign: bool = False
    on_progress: Callable[[Progress], None] | None = None
    on_warning: Callable[[str], None] | None = None
    on_event: Callable[[Any], None] | None = None  # with an Event
    history_s: float = 1.0
    on_arming: Callable[[Any], None] | None = None  # with the Session, which imports this
    resumes: bool = False
    sound: bool = False
    sound_device: str = ""
    sound_file: str | Path | None = None
    volume_db: float = 0.0
    latency_s: float = 0.015
