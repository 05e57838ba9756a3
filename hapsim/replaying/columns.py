"""A record as columns in SI units, piece by piece, for the files that `hapsim export` writes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import BEFORE, LATE_FORCE, VELOCITY
from hapsim.prediction.timing import time_to_live_samples
from hapsim.recording.feed import Scales
from hapsim.recording.stream import open_record
from hapsim.running.recorded_run import prediction_of
from hapsim.scene import parse_scene
from hapsim.units import MOTIONS, Units


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
        self.reader = open_record(path)
        head, report = self.reader.head, self.reader.summary.get("report", {})
        if not self.reader.count:
            raise UsageError(f"{path}: found a record without rows, expected some: the run ended before its first")
        self.path, self.count, self.channels, self.rate = path, self.reader.count, head.channels, head.rate_hz
        self.notes, self.run = self.reader.notes, head.run or {}
        motions = [*report.get("motion", ()), *MOTIONS[:1] * head.channels]
        self._units = [Units([motion]) for motion in motions[: head.channels]]
        self.dropped = int(report.get("dropped_rows", 0))
        """Rows that the recorder did not get."""
        self.ending = str(report.get("ending", "")) if self.reader.is_finished else "the record stops here"
        names = head.rows.names or ()
        self.velocity_scale = (
            np.array(self.run["description"]["velocity_scale"][: head.channels]) if VELOCITY in names else None
        )
        self.before = [name for name in BEFORE if name in names]
        self.all = [column for column in _COLUMNS if self._has(column.name)]

    def _has(self, name: str) -> bool:
        if name == "sensed_velocity":
            return self.velocity_scale is not None
        return name in self.before or name not in BEFORE

    def units_of(self, column: Column) -> list[str]:
        """Returns the unit of each number that the column has in a row."""
        if not column.by_channel:
            return [column.unit]
        return [units(f"in {column.unit}").removeprefix("in ") for units in self._units]

    def units_text(self, column: Column) -> str:
        """Returns the column's unit; where channels have different ones, each in their order: "rad, m"."""
        each = self.units_of(column)
        return ", ".join(each if len({*each}) > 1 else each[:1])

    def names_of(self, column: Column) -> list[str]:
        """Returns a name for each number that the column has in a row: "position_0"."""
        return [f"{column.name}_{c}" for c in range(self.channels)] if column.by_channel else [column.name]

    def pieces(self) -> Iterator[dict[str, NDArray[Any]]]:
        """Yields the values of the rows by the names of their columns, some thousands at a time."""
        head = self.reader.head
        scales = Scales(head.rate_hz, np.array(head.position_scale), np.array(head.force_scale))
        longest = time_to_live_samples(head.rate_hz) + 2
        age, before = 0, None
        for rows in self.reader.rows():
            samples = scales.samples(rows)
            age_of_each = ages(rows["flags"], age)
            age = int(age_of_each[-1])
            values = {
                "time": samples.sample / head.rate_hz,
                "sample": samples.sample,
                "arrival": samples.time_ns,
                "position": samples.position,
                "velocity": samples.velocity,
                "force": samples.force,
                "asked_force": rows["asked_force"],
                "flags": samples.flags,
                "age": np.minimum(age_of_each, longest),
                "lost": np.diff(samples.sample, prepend=samples.sample[0] - 1 if before is None else before) - 1,
            }
            before = samples.sample[-1]
            if self.velocity_scale is not None:
                values["sensed_velocity"] = rows[VELOCITY] * self.velocity_scale
            yield values | {name: rows[name] for name in self.before}

    def _prediction(self) -> dict[str, Any]:
        """What was predicted of its scene; a record that was cut off does not have it."""
        for note in self.notes:
            if "prediction" in note:
                return dict(note["prediction"])
        return prediction_of(parse_scene(json.dumps(self.run["scene"]), str(self.path)))

    @property
    def documents(self) -> dict[str, Any]:
        """What the record says of its run, by name: the scene as YAML, the rest for JSON. Less in an older record."""
        known: dict[str, Any] = {}
        if self.run:
            scene = yaml.safe_dump(self.run["scene"], sort_keys=False, allow_unicode=True)
            known = {name: self.run[name] for name in ("options", "excitation", "versions")}
            known |= {"scene": scene, "device": self.run["description"], "prediction": self._prediction()}
        return known | {"report": self.reader.summary.get("report", {})}

    @property
    def changes(self) -> list[tuple[int, str]]:
        """Of each change of the scene: the first row with it, and what changed, as JSON."""
        noted = [(note["tick"] - self.run["first_tick"], note) for note in self.notes if "tick" in note]
        return [(row, json.dumps({key: note[key] for key in note if key != "tick"})) for row, note in noted]

    @property
    def markers(self) -> list[tuple[int, str]]:
        """Of each marker: the sample at which it was set, and its text."""
        return [(note["sample"], note["marker"]) for note in self.notes if "marker" in note]


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
    Column("lost", "1", "positions before this one that never arrived", "i4"),
    *(
        Column(name, "ns", f"time before the position's arrival {what}", "i4")
        for name, what in zip(
            BEFORE,
            ("that the loop woke up", "that it asked for the position", "that the last force had left"),
            strict=True,
        )
    ),
)
