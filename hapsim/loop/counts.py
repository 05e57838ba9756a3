"""The counters of a run in one table, and its progress. A counter is an entry of `Counts` and the line that counts.

STATE of `exchange.py`, reports, records, JSON, the table of a run, its status, the live line and the page are made from
the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

_SHORTEST_S = 0.25  # in less, a few positions that arrive together distort the rate

Place = Literal["row", "live", "status"]
"""Display of a count: a run's table, its live line and the page, its status."""


def _counter(row: str = "", live: str = "", *, status: str | bool = "", at: str = "") -> Any:
    """Returns the field of a count that begins at 0.

    `row`: its label in a run's table. `live`: the words behind it in the live line and on the page. Both omit zero.
    `status`: its label in the status (True: as in the table). `at`: the path of the field of a LOOP that counts it, or
    "state" for the field of STATE with its name."""
    return field(default=0, metadata={"row": row, "live": live, "status": row if status is True else status, "at": at})


def _estimate(status: str, unit: str = "") -> Any:
    """Returns the field of an estimate for each channel. `status`: its label in the status."""
    return field(default=(), metadata={"status": f"{status}  {unit}" if unit else status})


@dataclass(frozen=True, kw_only=True)
class Counts:
    """The counts and estimates of a run. Tuples have an entry for each channel. `running.outcome.counters_of` computes
    those without an `at`."""

    ticks: int = _counter(status="ticks", at="state")
    deadline_misses: int = _counter(status="deadline misses", at="state")
    """Samples whose force came too late, so that the one before kept acting."""
    parameter_changes: int = 0
    """Accepted changes of the running scene: sets of parameters, or another structure."""
    lost_frames: int = _counter("positions lost", at="state")
    """Positions that were lost or damaged on the wire."""
    crc_errors: int = _counter("frames refused by this host")
    """Frames of the device that failed the check (too short or malformed ones included)."""
    garbage_bytes: int = _counter("bytes that were no frame")
    """Bytes from the device, since it was armed, that belonged to no frame."""
    stale_positions: int = _counter("stale positions", at="state")
    """Positions that a newer one replaced before they were answered."""
    limited_ticks: int = _counter("ticks at the force limit", "at the limit", status=True, at="state")
    """Ticks whose force was clipped at its limit."""
    slewed_ticks: int = _counter("ticks at the slew limit or in the soft start", "slewed", at="state")
    """Ticks whose force the slew limit or the soft start brought closer to the one before."""
    slowed_ticks: int = _counter("ticks in which changes were slowed", "with changes slowed")
    """Ticks that slowed a change of the running scene, which would have given the hand too much energy."""
    faded_ticks: int = _counter("ticks outside the travel, force faded", "outside the travel", at="travel.faded_ticks")
    """Ticks outside the device's travel, whose force faded."""
    saturated_lines: int = _counter("ticks with a line beyond the board's numbers", at="board_law.saturated")
    """Ticks whose line has more stiffness or damping than the device takes, so that it got the most that it takes."""
    sensor_tests: int = _counter("force lowered to test a sensor", at="frozen_sensor.tests")
    """Times that a channel's force was lowered, to test whether a position that stands still responds."""
    frozen_ticks: int = _counter(
        "ticks without force: position stood still",
        "without force at a position that stood still",
        at="frozen_sensor.frozen_ticks",
    )
    """Ticks in which a channel had no force, because its position did not respond."""
    withheld_forces: int = _counter("forces withheld: position too old", at="state")
    """Times that zero force was sent because the position was older than a force may live."""
    sign_tests: int = _counter("releases to test a motor's sign", at="sign.tests")
    """Times that a channel's force was released for some milliseconds, to test which way its motor pushes."""
    limited_commands: int = _counter(
        "commands at the limit of speed or acceleration", "commands limited", status=True, at="command_limit.limited"
    )
    """Ticks in which a command was brought within its largest speed and acceleration (`mode: admittance`)."""
    force_tests: int = _counter("stops to test a force sensor's sign", at="force_sensor.tests")
    """Times that a command was stopped for some milliseconds, to test which way a force sensor shows."""
    dropped_rows: int = _counter("rows not recorded: too slow a reader", at="ring.dropped")
    """Rows missing from the trace because its reader was too slow; the force was not affected."""
    unrecorded_rows: int = _counter("rows not recorded: too slow a file")
    """Rows missing from the recorded file, which failed or was too slow; the force was not affected."""
    underruns: int = _counter("gaps in the sound (underruns)", "gaps in the sound")
    """Gaps in the played sound: times that the sound card got no frames, or got them too late."""
    lost_sound_frames: int = _counter("frames of the sound lost", "frames of it lost")
    """Frames missing from the sound file, or not played because the sound card stopped."""
    clipped_sound_values: int = _counter("values of the sound clipped", "values of it clipped")
    """Values of the sound's frames that the soft clip changed."""
    sound_frames: int = 0
    """Frames of the scene's sound, if it is played or written: one for each step of its modules."""
    frozen: str = field(default="", metadata={"status": "sensor"})
    """Sentence about a position that stands still while force acts; in a report, the one that did so for longest."""
    wrong_sensor: str = field(default="", metadata={"status": "acceleration sensor"})
    """Sentence about a sensed acceleration that contradicts the positions."""
    armed_inside: str = field(default="", metadata={"status": "armed"})
    """Sentence about a hand that was armed deeper inside a contact than the force limit presses."""
    unknown_motor: str = field(default="", metadata={"status": "motor"})
    """Sentence about motors of a port that have a lower force limit, because nothing has shown them to be right."""
    estimated_mass_kg: tuple[float | None, ...] = _estimate("estimated mass", "‹kg›")
    """Last estimate of each channel's mass, with an adaptive correction; None on other channels."""
    estimated_mass_uncertainty_kg: tuple[float | None, ...] = _estimate("its uncertainty", "‹kg›")
    """Standard uncertainty of the mass; the whole span before the first estimate."""
    mass_explained: tuple[float | None, ...] = _estimate("motion explained")
    """R²: the share of the latest compared motion that the forces explain."""
    mass_age_s: tuple[float | None, ...] = _estimate("mass last seen before", "s")
    """Seconds since the motion last showed the mass: another hand may have gripped the device since."""
    resampling_ppm: float | None = None
    """Rate of the device's clock over the sound card's, less 1, in parts per million, by declared rates."""
    sound_latency_s: tuple[float, float] | None = None
    """Delay from the arrival of a position to the loudspeaker, s: median and 99th percentile."""

    def shown(self, place: Place) -> list[tuple[str, Any]]:
        """Returns the label and the value of each entry that is displayed at `place` and is not 0."""
        return [(words, value) for name, words in words_at(place).items() if (value := getattr(self, name))]

    def status(self) -> dict[str, Any]:
        """Returns the entries of the status, by name."""
        return {name: getattr(self, name) for name in words_at("status")}


def words_at(place: Place | Literal["at"]) -> dict[str, str]:
    """Returns the label of each entry that is displayed at a place, by name; for "at", its path in LOOP."""
    words = {name: one.metadata.get(place, "") for name, one in Counts.__dataclass_fields__.items()}
    return {name: text for name, text in words.items() if text}


@dataclass(frozen=True)
class Progress(Counts):
    """Progress of a run, for a live line."""

    phase: Literal["compiling", "running", "ended", "waiting", "serving"]
    text: str = ""
    share: float | None = None
    """Share of the work that is done, 0 to 1; None if unknown."""
    elapsed_s: float = 0.0
    rate_hz: float = 0.0
    force: tuple[float, ...] = ()
    """Force on each channel, (C,) N."""
    position: tuple[float, ...] = ()
    """Position of each channel, (C,) m."""
    age_samples: int = 0
    words: Mapping[str, int] = field(default_factory=dict)
    """Value of each input (1: on) and output, by "inputs.touch" and "outputs.code"."""

    @property
    def seen_rate_hz(self) -> float | None:
        """Rate in Hz; None during the first 0.25 s."""
        return self.rate_hz if self.elapsed_s >= _SHORTEST_S else None
