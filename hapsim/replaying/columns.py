"""A record as columns in SI units, piece by piece, for the files that `hapsim export` writes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from hapsim.loop.ring import LATE_FORCE, VELOCITY
from hapsim.prediction.timing import time_to_live_samples
from hapsim.recording.feed import Scales
from hapsim.recording.stream import open_record, reading
from hapsim.running.recorded_run import prediction_of, read_run
from hapsim.scene import Scene, parse_scene
from hapsim.units import Units


class Column(NamedTuple):
    """A quantity of a record: a value for each row, or with `by_channel` one for each channel."""

    name: str
    unit: str
    """Of a linear channel; "1": a number."""
    description: str
    dtype: str
    by_channel: bool = False


class Columns:
    """The columns of a record, and what it has beside them."""

    def __init__(self, path: Path) -> None:
        """Reads it once. UsageError where it is no record, is damaged, or has no rows."""
        self.path, self.reader = path, open_record(path)
        with reading(path):
            self._read()

    def _read(self) -> None:
        self.head, self.report = self.reader.head, self.reader.summary["report"]
        self.count, self.channels = self.reader.count, self.head.channels
        motions = [*self.report.get("motion", ()), *["linear"] * self.channels]
        self._units = [Units([motion]) for motion in motions[: self.channels]]
        self.has_velocity = VELOCITY in (self.head.rows.names or ())
        self.all = [column for column in _COLUMNS if self.has_velocity or column.name != "sensed_velocity"]
        notes = self.reader.notes
        self.markers = [(note["sample"], note["marker"]) for note in notes if "marker" in note]
        """Of each marker: the sample at which it was set, and its text."""
        self.documents: dict[str, Any] = {"report": self.report}
        """What the record says of its run, by name: the scene as YAML, the rest for JSON."""
        self.changes: list[tuple[int, str]] = []
        """Of each change of the scene: the first row with it, and what changed, as JSON."""
        self.scene: Scene | None = None
        """None in an older record, which has neither documents nor changes."""
        if (run := self.head.run) is not None:
            read_run(run, self.channels)
            self.scene = scene = parse_scene(json.dumps(run["scene"]), str(self.path))
            predicted = [note["prediction"] for note in notes if "prediction" in note]  # not where it was cut off
            self.documents |= {name: run[name] for name in ("options", "excitation", "versions")} | {
                "scene": yaml.safe_dump(run["scene"], sort_keys=False, allow_unicode=True),
                "device": run["description"],
                "prediction": predicted[0] if predicted else prediction_of(scene),
            }
            for note in notes:
                if "tick" in note:
                    changed = {key: value for key, value in note.items() if key != "tick"}
                    self.changes.append((note["tick"] - run["first_tick"], json.dumps(changed)))

    def units_of(self, column: Column) -> list[str]:
        """Returns the unit of each number that the column has in a row."""
        if not column.by_channel:
            return [column.unit]
        return [units(f"in {column.unit}").removeprefix("in ") for units in self._units]

    def units_text(self, column: Column) -> str:
        """Returns the column's unit; where channels have different ones, each in their order: "rad, m"."""
        each = self.units_of(column)
        return ", ".join(each if len({*each}) > 1 else each[:1])

    def names_of(self, column: Column, before: str = "_") -> list[str]:
        """Returns a name for each number that the column has in a row: "position_0"; `before`: before a channel."""
        return [f"{column.name}{before}{c}" for c in range(self.channels)] if column.by_channel else [column.name]

    def pieces(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Yields the values of the rows by the names of their columns, some thousands at a time."""
        rate = self.head.rate_hz
        scales = Scales(rate, np.array(self.head.position_scale), np.array(self.head.force_scale))
        age, before = 0, None
        for rows in self.reader.rows():
            samples = scales.samples(rows)
            age_of_each = ages(rows["flags"], age)
            values = {
                "time": samples.sample / rate,
                "sample": samples.sample,
                "arrival": samples.time_ns,
                "position": samples.position,
                "velocity": samples.velocity,
                "force": samples.force,
                "asked_force": rows["asked_force"],
                "flags": samples.flags,
                "age": np.minimum(age_of_each, time_to_live_samples(rate) + 2),
                "lost": np.diff(samples.sample, prepend=samples.sample[0] - 1 if before is None else before) - 1,
            }
            if self.has_velocity:
                values["sensed_velocity"] = rows[VELOCITY] * np.array(self.documents["device"]["velocity_scale"])
            age, before = int(age_of_each[-1]), samples.sample[-1]
            yield values


def ages(flags: NDArray[np.uint8], before: int) -> NDArray[np.int64]:
    """Returns how many samples before each row the position came that the acting force answers; `before`: of the row
    before the first."""
    row = np.arange(1, len(flags) + 1)
    in_time = np.maximum.accumulate(np.where(flags & LATE_FORCE, 0, row))
    return np.where(in_time, row - in_time + 1, row + before)


_COLUMNS = (
    Column("time", "s", "since arming, by the device's count of samples", "f8"),
    Column("sample", "1", "the device's number of the position, counted from arming", "i8"),
    Column("arrival", "ns", "when the position arrived, by the host's monotonic clock", "i8"),
    Column("position", "m", "measured by the device, from the scene's origin", "f8", True),
    Column("velocity", "m/s", "backward difference of the positions", "f8", True),
    Column("sensed_velocity", "m/s", "measured by the device", "f8", True),
    Column("force", "N", "sent to the device in answer", "f8", True),
    Column("asked_force", "N", "of the scene's modules, before excitation, limits and rounding", "f8", True),
    Column("flags", "1", "what happened to the force: a sum of flag_masks", "u1"),
    Column("age", "1", "samples from the position that the acting force answers to its change, at most", "u2"),
    Column("lost", "1", "samples before this one that have no row: their positions never arrived", "i4"),
)
