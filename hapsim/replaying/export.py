"""A record as columns in SI units, and written for other programs: `hapsim export`."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from numpy.typing import NDArray

from firmware_protocol.description import Description
from firmware_protocol.lines import LARGEST_BOUND
from hapsim.documents import plain
from hapsim.errors import UsageError
from hapsim.loop import ring
from hapsim.loop.ring import LATE_FORCE, LINE, SENSED, WORDS, commands_in, sensed_in, words_in
from hapsim.prediction.timing import time_to_live_samples
from hapsim.recording.background_file import require_writable
from hapsim.recording.recorder import Scales
from hapsim.recording.stream import open_record, reading
from hapsim.recording.times import Marker, markers_of, rows_of
from hapsim.recording.trace import convert
from hapsim.replaying.replay import Record, Replay
from hapsim.replaying.tables import table_of, write_table
from hapsim.running.recorded_run import prediction_of, read_run
from hapsim.scene import Scene
from hapsim.scene.issue import one_of
from hapsim.scene.load import recorded_scene
from hapsim.sound.wav import WavFile, require_writable_as_wav
from hapsim.units import Units
from hapsim.whole_file import file_for_hdf5, whole_file

_PACKAGES = {".h5": "h5py", ".mcap": "mcap"}
_FLAGS = ("LATE_FORCE", "UNSENT", "LIMITED", "BRIDGED", "OFF_GRID", "SLEWED", "WITHHELD", "FADED")
_ENDINGS = (".h5", ".csv", ".npz", ".wav", ".mcap", ".tsv")


def require_exportable(out: Path, column: str | None) -> None:
    """Raises UsageError where no record can be exported to `out`, before it is read. `column`: of a .wav."""
    if out.suffix == ".yaml":
        raise UsageError(f"{out}: a scene needs --scene-at, the time at which it was as it is to be written")
    if out.suffix not in _ENDINGS:
        raise UsageError(f"{out}: found the ending '{out.suffix}', expected {one_of(_ENDINGS)}")
    if out.suffix == ".tsv":
        table_of(out)
    package = _PACKAGES.get(out.suffix)
    if package is not None and importlib.util.find_spec(package) is None:
        raise UsageError(f"{out}: found no Python package {package}, expected it: pip install 'hapsim[record]'")
    if (column is None) == (out.suffix == ".wav"):
        raise UsageError(
            f"{out}: a .wav needs --column, such as --column position.0 or the name of a pick-up; other files have all "
            "columns, and take no --column"
        )
    require_writable(out)


def export(columns: Columns, out: Path, column: str | None, on_share: Callable[[float], None]) -> tuple[float, str]:
    """Writes a record as `out`, in constant memory. Returns what a .wav has at full scale, and its unit.

    `column`: of a .wav, such as position.0, or a pick-up. `on_share`: called with the share of rows read.
    Raises UsageError.
    """
    columns.reader.on_rows = lambda rows: on_share(rows / columns.count)
    with whole_file(out) as file:
        if column is not None:
            return _write_sound(file, columns, column)
        if out.suffix == ".h5":
            _write_hdf5(file, columns)
        elif out.suffix == ".mcap":
            _write_mcap(file, columns)
        elif out.suffix == ".tsv":
            write_table(file, table_of(out), columns.reader, columns.timeline)
        else:
            convert(columns.reader, file, out.suffix)
    return 0.0, ""


def _write_sound(file: Path, columns: Columns, wanted: str) -> tuple[float, str]:
    """Returns full scale and its unit."""
    of_channels = [column for column in columns.all if column.by_channel]
    each = {name: column for column in of_channels for name in columns.names_of(column, ".")}
    pick_ups = [*columns.scene.sound] if columns.scene else []
    if wanted in pick_ups:
        replay = Replay(Record(columns.path), None, file, wanted)  # at the level of `run --sound-file`
        replay.record.reader.on_rows = columns.reader.on_rows
        for _ in replay.pieces():
            pass
        replay.close(keeps_part=False)
        return 1.0, ""
    if wanted not in each:
        raise UsageError(f"--column: found '{wanted}', expected {one_of([*each, *pick_ups])}")
    column, channel, rate = each[wanted], int(wanted.rpartition(".")[2]), columns.head.rate_hz
    require_writable_as_wav(file, 1, rate)

    def values() -> Iterator[tuple[NDArray[np.float64], NDArray[np.int64]]]:
        for piece in columns.pieces():
            yield np.nan_to_num(piece[column.name][:, channel], posinf=0.0, neginf=0.0), piece["lost"]

    full_scale = max(float(np.abs(one).max()) for one, _ in values()) or 1.0
    wav, before = WavFile(file, 1, round(rate), lambda _: None), 0.0
    for one, lost in values():  # a value that was lost is the one before it
        held = np.column_stack([np.append(before, one[:-1]), one]).ravel()
        times = np.column_stack([lost, np.ones_like(lost)]).ravel()
        wav.put((np.repeat(held, times) / full_scale).astype(np.float32)[:, None], patient=True)
        before = one[-1]
    wav.finish()
    if wav.failure:
        raise OSError(wav.failure)
    return full_scale, columns.units_of(column)[channel]


def _write_hdf5(path: Path, columns: Columns) -> None:
    """Writes a dataset for each column, with its unit; the rest of the record as texts in the group `record`.

    The datasets are plain arrays with dimension scales, `time` and `channel`, by which xarray names their dimensions.
    OSError where it cannot be written."""
    import h5py

    with file_for_hdf5(path) as place, h5py.File(place, "w") as file:
        file["channel"] = np.arange(columns.channels)
        file["channel"].attrs.update(units="1", description="of the device")
        file["channel"].make_scale("channel")
        for column in columns.all:
            shape = (columns.count, columns.channels)[: 1 + column.by_channel]
            made = file.create_dataset(column.name, shape, column.dtype)
            made.attrs.update(units=columns.units_text(column), description=column.description)
            if column.name == "time":  # the first
                made.make_scale("time")
                continue
            for at, name in enumerate(("time", "channel")[: made.ndim]):
                made.dims[at].attach_scale(file[name])
        file["flags"].attrs["flag_masks"] = np.array([getattr(ring, name) for name in _FLAGS], "u1")
        file["flags"].attrs["flag_meanings"] = " ".join(_FLAGS).lower()
        first = 0
        for values in columns.pieces():
            place.require_written()
            after = first + len(values["time"])
            for name, one in values.items():
                file[name][first:after] = one
            first = after
        file.attrs.update(rate_hz=columns.head.rate_hz, begun=columns.head.begun, ending=columns.report["ending"])
        group = file.create_group("record")
        for name, document in columns.documents.items():
            group[name] = document if isinstance(document, str) else json.dumps(document)
        markers = [(one.sample, one.text) for one in columns.markers]
        for name, of, entries in (("change", "row", columns.changes), ("marker", "sample", markers)):
            group[name] = np.array([text for _, text in entries], h5py.string_dtype())
            group[f"{name}_{of}"] = np.array([place for place, _ in entries], np.int64)
        group["marker_time"] = np.array(columns.marker_times)


def _write_mcap(path: Path, columns: Columns) -> None:
    """Writes a JSON message for each row, which has a number for each quantity of each channel. The times of messages
    are the system's real times. OSError where it cannot be written."""
    from mcap.writer import Writer

    begun, clock = columns.head.begun, columns.head.clock
    begun_ns = round(datetime.fromisoformat(begun).timestamp() * 1e9) if begun else 0  # in an older record
    begun_ns = begun_ns if clock is None else clock.realtime_offset_ns + columns.timeline.start_ns
    fields = {
        name: {"type": "number", "description": f"{column.description} ({unit})"}
        for column in columns.all
        for name, unit in zip(columns.names_of(column), columns.units_of(column), strict=True)
    }
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start("", "hapsim")
        text_of = {"text": {"type": "string"}}
        described = {"samples": fields, "changes": text_of, "markers": text_of}
        samples, changes, markers = (_mcap_channel(writer, name, one) for name, one in described.items())
        first_row = 0

        def add(channel: int, time_s: float, message: dict[str, Any]) -> None:
            at = begun_ns + round(time_s * 1e9)
            writer.add_message(channel, at, json.dumps(message).encode(), at)

        for values in columns.pieces():
            for row, text in columns.changes:
                if first_row <= row < first_row + len(values["time"]):
                    add(changes, float(values["time"][row - first_row]), {"text": text})
            first_row += len(values["time"])
            finite = np.isfinite(values["asked_force"]).all()
            each = [one for column in columns.all for one in np.atleast_2d(values[column.name].T).tolist()]
            for row_values in zip(*each, strict=True):
                message = dict(zip(fields, row_values, strict=True))
                add(samples, message["time"], message if finite else plain(message))
        for time_s, marker in zip(columns.marker_times, columns.markers, strict=True):
            add(markers, time_s, {"text": marker.text})
        texts = columns.documents.items()
        writer.add_metadata("record", {name: one if isinstance(one, str) else json.dumps(one) for name, one in texts})
        writer.finish()


def _mcap_channel(writer: Any, name: str, fields: dict[str, Any]) -> int:
    schema = json.dumps({"type": "object", "properties": fields}).encode()
    return writer.register_channel(f"/hapsim/{name}", "json", writer.register_schema(name, "jsonschema", schema))


class Column(NamedTuple):
    """A quantity of a record: a value for each row, or with `by_channel` one for each channel."""

    name: str
    unit: str
    """Unit for a linear channel; "1" for a number."""
    description: str
    dtype: str
    by_channel: bool = False


class Columns:
    """The columns of a record, its scene, documents, changes and markers."""

    def __init__(self, path: Path) -> None:
        """Reads the record once. Raises UsageError if it is none, is damaged, or has no rows."""
        self.path, self.reader = path, open_record(path)
        with reading(path):
            self._read()

    def _read(self) -> None:
        self.head, self.report = self.reader.head, self.reader.summary["report"]
        self.count, self.channels = self.reader.count, self.head.channels
        motions = [*self.report.get("motion", ()), *["linear"] * self.channels]
        self._units = [Units.of([motion]) for motion in motions[: self.channels]]
        absent = {f"sensed_{name}" for name in SENSED if name not in self.head.sensed}
        absent |= set() if self.head.lines else _OF_LINES.keys()
        absent |= set() if self.head.words else {*WORDS}
        absent |= set() if self.head.hand_force else {"command"}
        self.all = [column for column in _COLUMNS if column.name not in absent]
        notes = self.reader.notes
        self.timeline, self.markers = self.reader.timeline(), markers_of(notes)
        self.marker_times = self._times_of_markers()
        """The time of each marker's row, s."""
        clock = self.head.clock._asdict() if self.head.clock else {}
        clock |= {"time_source": self.timeline.source, "time_0_ns": self.timeline.start_ns}
        self.documents: dict[str, Any] = {"report": self.report, "clock": clock}
        """Documents about the run, by name: the scene as YAML, the rest for JSON."""
        self.changes: list[tuple[int, str]] = []
        """The first row of each change of the scene, and the change as JSON."""
        self.scene: Scene | None = None
        """None in an older record, which has neither documents nor changes."""
        if (run := self.head.run) is not None:
            description = read_run(run, self.channels).description
            self.scene = scene = recorded_scene(run["scene"], str(self.path), self.report.get("written", ()))
            self.all += [Column(name, "1", _OF_WORDS[name.partition(".")[0]], "u4") for name in scene.word_values(0, 0)]
            predicted = [note["prediction"] for note in notes if "prediction" in note]  # not where it was cut off
            self.documents |= {name: run[name] for name in ("options", "excitation", "versions")} | {
                "scene": yaml.safe_dump(run["scene"], sort_keys=False, allow_unicode=True),
                "device": run["description"],
                "prediction": predicted[0] if predicted else prediction_of(scene, description),
            }
            for note in notes:
                if "tick" in note:
                    changed = {key: value for key, value in note.items() if key not in ("tick", "sample")}
                    self.changes.append((note["tick"] - run["first_tick"], json.dumps(changed)))

    def _times_of_markers(self) -> list[float]:
        times, before = dict[Marker, float](), -1
        for rows in self.reader.rows() if self.markers else ():
            time_s = self.timeline.of(rows["sample"], rows["time_ns"])
            times |= {
                one: float(time_s[row])
                for row, one in rows_of(self.markers, rows["sample"], before, self.timeline.last)
            }
            before = int(rows["sample"][-1])
        return [times[one] for one in self.markers]

    def units_of(self, column: Column) -> list[str]:
        """Returns the unit of each number that the column has in a row."""
        if not column.by_channel:
            return [column.unit]
        return [units.name(column.unit) for units in self._units]

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
        own = {"position": self.head.position_scale, "force": self.head.force_scale}
        scales = Scales(rate, lambda name: np.array(own[name] if name in own else self.head.sensed_scale(name)))
        age, before = 0, None
        for rows in self.reader.rows():
            samples = scales.samples(rows)
            age_of_each = ages(rows["flags"], age)
            values = {
                "time": self.timeline.of(samples.sample, samples.time_ns),
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
            if self.head.lines and self.head.run is not None:
                values |= self._lines(rows, read_run(self.head.run, self.channels).description)
            values |= (words := words_in(rows)) | (self.scene.word_values(**words) if self.scene and words else {})
            values |= {f"sensed_{name}": of for name, of in sensed_in(rows, self.head.sensed_scale).items()}
            values |= {"command": commands_in(rows, self.head.position_scale)} if self.head.hand_force else {}
            age, before = int(age_of_each[-1]), samples.sample[-1]
            yield values

    def _lines(self, rows: NDArray[Any], description: Description) -> dict[str, NDArray[np.float64]]:
        """Returns the lines of rows in SI units. Raises ValueError if the device followed none."""
        if (lines := description.lines) is None:
            raise ValueError("found lines of a device that follows none")
        bound = np.array(description.force_limit) / LARGEST_BOUND
        scales = (self.head.force_scale, lines.stiffness_scale, lines.damping_scale, bound, bound)
        counts = ("force_counts", *LINE)
        return {name: rows[of] * np.array(each) for name, of, each in zip(_OF_LINES, counts, scales, strict=True)}


def ages(flags: NDArray[np.uint8], before: int) -> NDArray[np.int64]:
    """Returns how many samples before each row the position came that the acting force answers; `before`: of the row
    before the first."""
    row = np.arange(1, len(flags) + 1)
    in_time = np.maximum.accumulate(np.where(flags & LATE_FORCE, 0, row))
    return np.where(in_time, row - in_time + 1, row + before)


_OF_LINES = {
    "line_force": ("N", "of the line sent in answer, at this position, without damping"),
    "line_stiffness": ("N/m", "of that line"),
    "line_damping": ("N·s/m", "of that line"),
    "line_low": ("N", "the least force of that line"),
    "line_high": ("N", "the largest force of that line"),
}
_OF_WORDS = {"inputs": "1 while that input is on", "outputs": "the value of that output"}
_COLUMNS = (
    Column("time", "s", "since the first row, on the host's clock; time_source in the text clock says how", "f8"),
    Column("sample", "1", "the device's number of the position, counted from arming", "i8"),
    Column("arrival", "ns", "when the position arrived, by the host's monotonic clock", "i8"),
    Column("position", "m", "measured by the device, from the scene's origin", "f8", True),
    Column("velocity", "m/s", "backward difference of the positions", "f8", True),
    Column("sensed_velocity", "m/s", "measured by the device", "f8", True),
    Column("sensed_acceleration", "m/s²", "measured by the device", "f8", True),
    Column("sensed_hand_force", "N", "of the hand on the handle, measured by the device", "f8", True),
    Column("command", "m", "position sent in answer, with mode: admittance; from the scene's origin", "f8", True),
    Column("force", "N", "under law: board that of the sample that ended, else sent in answer", "f8", True),
    *(Column(name, unit, words, "f8", True) for name, (unit, words) in _OF_LINES.items()),
    Column("asked_force", "N", "of the scene's modules, before excitation, limits and rounding", "f8", True),
    Column("flags", "1", "what happened to the force: a sum of flag_masks", "u1"),
    Column("age", "1", "samples from the position that the acting force answers to its change, at most", "u2"),
    Column("lost", "1", "samples before this one that have no row: their positions never arrived", "i4"),
    Column("inputs", "1", "the digital word that came with the position", "u4"),
    Column("outputs", "1", "the digital word that went with the answer", "u4"),
)
