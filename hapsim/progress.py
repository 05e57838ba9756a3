"""What a run counts, and how it is doing, for whatever shows it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

_SHORTEST_S = 0.25  # in less, a few positions that came together make a rate of their own


def _counted(row: str = "", live: str = "") -> Any:
    """A count that begins at 0. `row`: its name in a run's table; `live`: what follows it in the live line. It is shown
    there once it is not 0."""
    return field(default=0, metadata={"row": row, "live": live})


@dataclass(frozen=True, kw_only=True)
class Counts:
    """What a run counted, and what it estimated. An entry here is all that a counter needs to be in reports, records,
    JSON, status, table and live line; who counts is `running.outcome.counters_of`. Tuples have an entry for each
    channel."""

    ticks: int = 0
    deadline_misses: int = 0
    """Samples whose force came too late, so that the one before went on acting."""
    parameter_changes: int = 0
    """Accepted changes of the running scene: sets of parameters, or another structure."""
    lost_frames: int = _counted("positions lost")
    """Positions that never arrived whole."""
    crc_errors: int = _counted("frames refused by this host")
    """Frames of the device that failed the check (too short or malformed ones included)."""
    garbage_bytes: int = _counted("bytes that were no frame")
    """Bytes from the device, since it was armed, that belonged to no frame."""
    stale_positions: int = _counted("stale positions")
    """Positions that a newer one replaced before they could be answered."""
    limited_ticks: int = _counted("ticks at the force limit", "at the limit")
    """Ticks whose force was clipped at its limit."""
    slewed_ticks: int = _counted("ticks at the slew limit or in the soft start", "slewed")
    """Ticks whose force the slew limit or the soft start brought closer to the one before."""
    slowed_ticks: int = _counted("ticks in which changes were slowed", "with changes slowed")
    """Ticks that slowed a change of the running scene, which would have given the hand too much energy."""
    faded_ticks: int = _counted("ticks outside the travel, force faded", "outside the travel")
    """Ticks outside the device's travel, whose force faded."""
    sensor_tests: int = _counted("force lowered to test a sensor")
    """Times that a channel's force was lowered, to see whether a position that stood still still answers."""
    frozen_ticks: int = _counted(
        "ticks without force: position stood still", "without force at a position that stood still"
    )
    """Ticks in which a channel had no force, because its position did not answer."""
    withheld_forces: int = _counted("forces withheld: position too old")
    """Times that zero force was sent because the position was older than a force may live."""
    sign_tests: int = _counted("releases to test a motor's sign")
    """Times that a channel's force was released for some milliseconds, to see which way its motor pushes."""
    dropped_rows: int = _counted("rows not recorded: too slow a reader")
    """Rows missing from the trace because its reader was too slow; the force was not affected."""
    unrecorded_rows: int = _counted("rows not recorded: too slow a file")
    """Rows missing from the recorded file, which could not be written, or not fast enough. The force was not
    affected."""
    underruns: int = _counted("gaps in the sound (underruns)", "gaps in the sound")
    """Gaps in what was played: times that the sound card got no frames, or got them too late."""
    lost_sound_frames: int = _counted("frames of the sound lost", "frames of it lost")
    """Frames that are missing from the sound file, or were not played because the sound card stood still."""
    clipped_sound_values: int = _counted("values of the sound clipped", "values of it clipped")
    """Values of the sound's frames that the soft clip changed."""
    sound_frames: int = 0
    """Frames of the scene's sound, where it is played or written: one for each step of its modules."""
    frozen: str = ""
    """What is said of a position that stands still while force acts: in a report of the one that did so for longest."""
    estimated_mass_kg: tuple[float | None, ...] = ()
    """With an adaptive correction: the last estimate of each channel's mass; None on the others."""
    estimated_mass_uncertainty_kg: tuple[float | None, ...] = ()
    """Its standard uncertainty; the whole span if nothing was known."""
    mass_explained: tuple[float | None, ...] = ()
    """R²: the share of the latest motion that was compared which the forces explain."""
    mass_age_s: tuple[float | None, ...] = ()
    """Seconds since the motion last showed the mass: the hand may have become another one meanwhile."""
    resampling_ppm: float | None = None
    """How much faster the device's clock is than the sound card's, in parts per million of what both declare."""
    sound_latency_s: tuple[float, float] | None = None
    """From the arrival of a position to the loudspeaker: median and 99th percentile."""

    def shown(self, where: Literal["row", "live"]) -> list[tuple[str, int]]:
        """What is not 0 of what is shown there: its words, and the count."""
        entries = ((one.metadata.get(where), getattr(self, name)) for name, one in self.__dataclass_fields__.items())
        return [(words, count) for words, count in entries if words and count]


@dataclass(frozen=True)
class Progress(Counts):
    """How a run is doing, for a live line."""

    phase: Literal["compiling", "running", "ended", "waiting", "serving"]
    text: str = ""
    share: float | None = None
    """How far it is, 0 to 1, where that is known."""
    elapsed_s: float = 0.0
    rate_hz: float = 0.0
    force: tuple[float, ...] = ()
    """(C,) N."""
    position: tuple[float, ...] = ()
    """(C,) m."""
    age_samples: int = 0

    @property
    def seen_rate_hz(self) -> float | None:
        """The rate, once it is one of more than a few milliseconds."""
        return self.rate_hz if self.elapsed_s >= _SHORTEST_S else None
