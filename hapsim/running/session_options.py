"""The options of a session, and the forces that can be added to the scene's."""

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
    from hapsim.scene import Scene


@dataclass(frozen=True)
class Guide:
    """A target to which a hand is led before its excitation, and the guide's parameters (`hapsim.loop.guide`)."""

    target: float
    """Target from the scene's position 0, m."""
    stiffness: float
    """Stiffness of the guide's spring, N/m."""
    beyond: float = 0.0
    """Overshoot of the path beyond the target, m."""
    seconds: tuple[float, float, float, float] = (2.0, 1.0, 0.25, 0.25)
    """Durations of the path, of settling, of the mean and of the crossfade, s."""
    also: tuple[tuple[int, float, float], ...] = ()
    """Channels of the hand's other coordinates, each with its target and overshoot, m."""

    def ticks(self, rate_hz: float) -> tuple[int, ...]:
        """Returns these durations in ticks."""
        return tuple(max(1, round(one * rate_hz)) for one in self.seconds)


@dataclass(frozen=True)
class Excitation:
    """Pushes on one channel, each of `ticks` samples, every `every` samples from sample `start` on.

    Their sign alternates, and their sizes range from `force` (N) down to half of it, each different. They pass the
    guards like any force. `first`: also one push at the very beginning. `guide`: leads the hand to a target first;
    samples count from its end."""

    channel: int
    force: float
    ticks: int
    every: int
    start: int
    first: bool
    guide: Guide | None = None

    def ticks_before(self, rate_hz: float) -> int:
        """Returns the number of ticks of the guide."""
        return 0 if self.guide is None else sum(self.guide.ticks(rate_hz))


@dataclass(frozen=True, eq=False)
class PeriodicExcitation:
    """A periodic force on one channel: (N,) forces in N, one per sample.

    Sample n, by the device's count, has `forces[n % N]`: lost positions do not shift it. The forces pass the guards
    like any force."""

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
    also_sense: tuple[str, ...] = ()
    lsl: str | None = None

    def is_virtual(self, scene: Scene) -> bool:
        """Returns whether the scene runs in virtual time: as fast as possible."""
        return scene.device.clock == "lockstep" and self.transport != "paced"
