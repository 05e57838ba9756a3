"""Trace: the samples of a run, tick by tick, with its report."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from operator import itemgetter
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.loop.ring import (
    ACTED,
    LATE_FORCE,
    LIMITED,
    LINES,
    ROWS,
    WORDS,
    commands_in,
    lines_in,
    sensed_in,
    words_in,
)
from hapsim.recording.background_file import require_writable
from hapsim.recording.report import (
    NOT_FINISHED,
    Report,
    Statistics,
    read_summary,
    report_from,
    summary_document,
    validated,
)
from hapsim.recording.stream import Head, StreamReader, StreamWriter, is_stream
from hapsim.recording.times import Clock, Marker, Timeline, markers_of, rows_of, trial_at, trials_of
from hapsim.scene.load import recorded_scene

IN_REPORT = "trace.npz"
"""A trace's name in a report file."""
ZIP_WITHOUT_END = "a zip file that was cut short, or damaged at its end: get a whole copy of it"

_COUNTED = "counted_"  # before the name of a histogram in a .npz
_EXPECTED = "a .npz or .trace, the rest of one (.part), or a report file"


@dataclass(frozen=True, repr=False)
class Trace:
    """N ticks of C channels, in the order in which the positions arrived."""

    rate: float
    """Hz, nominal."""
    sample: NDArray[np.int64]
    """(N,) the device's number of each position, counted from arming."""
    time_ns: NDArray[np.int64]
    """(N,) monotonic time at which it arrived."""
    flags: NDArray[np.uint8]
    """(N,) LATE_FORCE, UNSENT, LIMITED, BRIDGED, OFF_GRID, SLEWED, WITHHELD, FADED of hapsim.loop.ring."""
    position_counts: NDArray[np.int32]
    """(N, C) as on the wire, less the scene's origin."""
    force_counts: NDArray[np.int32]
    """(N, C) the answer, as on the wire."""
    asked_force: NDArray[np.float64]
    """(N, C) N, the force of the scene's modules, before excitation, limit and rounding to counts."""
    position_scale: NDArray[np.float64]
    """(C,) m per count."""
    force_scale: NDArray[np.float64]
    """(C,) N per count."""
    statistics: Statistics
    report: Report
    sensed: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """(N, C) of each value that the device sent beside its positions: "velocity", m/s, "acceleration", m/s²,
    "hand_force", N. `save` does not write them; a .trace that `hapsim run --record` writes has them."""
    command: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0)))
    """(N, C) m, the commanded position in answer to each row, with `mode: admittance`; likewise."""

    line_counts: dict[str, NDArray[Any]] = field(default_factory=dict)
    """(N, C) of each of LINES of hapsim.loop.ring, if the device follows lines (`law: board`): "acted_force", N, and
    the line that answers each position, in counts."""

    clock: Clock | None = None
    """The host's clock of `time_ns`, and the system's real time by it; None in a file of an earlier version."""
    markers: tuple[Marker, ...] = ()
    """The markers of the run, each with the `sample` at which it was set."""
    trials: tuple[tuple[int, int], ...] = ()
    """First sample and number of each trial of the run."""
    inputs: NDArray[np.uint32] = field(default_factory=lambda: np.empty(0, np.uint32))
    """(N,) the digital word that came with each position; without entries where none is on the wire."""
    outputs: NDArray[np.uint32] = field(default_factory=lambda: np.empty(0, np.uint32))
    """(N,) likewise, the one that went with the answer."""

    def __repr__(self) -> str:
        samples = f" (samples {self.sample[0]} to {self.sample[-1]})" if self.sample.size else ""
        return (
            f"Trace({self.sample.size} rows{samples}, channels={self.position_scale.size}, rate={self.rate:g}, "
            f"ending={self.report.ending!r})"
        )

    @property
    def position(self) -> NDArray[np.float64]:
        """Positions (N, C), m."""
        return self.position_counts * self.position_scale

    @property
    def force(self) -> NDArray[np.float64]:
        """Sent forces (N, C), N."""
        return self.force_counts * self.force_scale

    @property
    def time_s(self) -> NDArray[np.float64]:
        """True times (N,) of the samples since the first row, s, on the host's clock: `timeline.source` says how."""
        return self.timeline.of(self.sample, self.time_ns)

    @property
    def trial(self) -> NDArray[np.int64]:
        """Number of the trial (N,) in each row; 0 before the first."""
        return trial_at(self.trials, self.sample)

    @property
    def timeline(self) -> Timeline:
        """Origin of the times, and their time 0 on the host's clock."""
        return Timeline(self.rate, self.report, [(self.sample, self.time_ns)])

    def since(self, tick: int) -> Trace:
        """Returns the rows from this tick on, with the same report."""
        sensed, lines = ({k: v[tick:] for k, v in of.items()} for of in (self.sensed, self.line_counts))
        cut = {name: getattr(self, name)[tick:] for name in (*ROWS, *WORDS, "command")}
        return replace(self, sensed=sensed, line_counts=lines, **cut)

    def save(self, path: str | Path) -> None:
        """Writes a .npz or .trace (unchanged arrays) or a .csv (SI units). Raises UsageError if it cannot."""
        path = Path(path)
        require_writable_as_trace(path)
        try:
            if path.suffix == ".npz":
                self.write_npz(path)
            elif path.suffix == ".csv":
                _write_csv(path, *self._head_and_rows, self.timeline, self.markers)
            else:
                self._write_stream(path)
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {error.strerror or error}") from error

    def write_npz(self, file: Path | BinaryIO) -> None:
        """Writes a .npz. Raises OSError if it cannot."""
        head, rows = self._head_and_rows
        summary = summary_document(self.report, self.statistics, True)
        _write_npz(file, head, lambda: rows, summary, self.timeline, self.markers, self.trials)

    def _write_stream(self, path: Path) -> None:
        head, (rows,) = self._head_and_rows
        summary = summary_document(self.report, self.statistics, True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0)
        writer = StreamWriter(os.open(path, flags, 0o666), head, summary)
        try:
            writer.write_rows(rows)
            for sample, text, at in self.markers:
                writer.write_note({"marker": text, "sample": sample, "at": at})
            for sample, number in self.trials:
                writer.write_note({"trial": number, "sample": sample})
            writer.write_summary(summary)
        finally:
            writer.close()

    @property
    def _head_and_rows(self) -> tuple[Head, list[NDArray[Any]]]:
        scales, has_words = (self.position_scale.tolist(), self.force_scale.tolist()), bool(self.inputs.size)
        head = Head(self.rate, *scales, lines=bool(self.line_counts), words=has_words, clock=self.clock)
        rows = np.empty(self.sample.size, head.rows)
        for name in (*ROWS, *(WORDS if has_words else ())):
            rows[name] = getattr(self, name)
        for name, values in self.line_counts.items():
            rows[name] = values
        return head, [rows]


def columns_of(rows: NDArray[Any]) -> dict[str, Any]:
    """Returns the columns of rows of `row_type`, by their names in a trace."""
    return {name: np.ascontiguousarray(rows[name]) for name in ROWS}


def convert(reader: StreamReader, file: Path, ending: str) -> None:
    """Writes a record as a .npz or .csv, with at most a chunk of its rows in memory. Raises OSError."""
    timeline = reader.timeline()
    markers = markers_of(reader.notes)
    if ending == ".csv":
        _write_csv(file, reader.head, reader.rows(), timeline, markers)
    else:
        _write_npz(file, reader.head, reader.rows, reader.summary, timeline, markers, trials_of(reader.notes))


def _write_csv(
    file: Path, head: Head, pieces: Iterable[NDArray[Any]], timeline: Timeline, markers: Sequence[Marker]
) -> None:
    """Writes rows as a table, in SI units; the last column has the texts of markers."""
    each = range(head.channels)
    names = [f"{what}[{c}]" for what in ("position_m", "force_N", "asked_force_N") for c in each] + ["time_s"]
    scene = recorded_scene(head.run["scene"], str(file)) if head.words and head.run else None
    named, before = scene.word_values(0, 0) if scene else {}, -1
    names += [*(WORDS if head.words else ()), *named]
    formats = ["%d", "%d", "%d"] + ["%.12g"] * (3 * head.channels + 1) + ["%d"] * (2 * head.words + len(named))
    with file.open("w", encoding="utf-8") as table:
        table.write(",".join(["sample", "time_ns", "flags", *names, "marker"]) + "\n")
        for rows in pieces:
            position = rows["position_counts"] * np.array(head.position_scale)
            force = rows[ACTED] if head.lines else rows["force_counts"] * np.array(head.force_scale)
            columns = [rows["sample"], rows["time_ns"], rows["flags"], position, force, rows["asked_force"]]
            columns += [timeline.of(rows["sample"], rows["time_ns"]), *(words := words_in(rows)).values()]
            columns += scene.word_values(**words).values() if scene else ()
            np.savetxt(text := io.StringIO(), np.column_stack(columns), fmt=formats, delimiter=",")
            texts: dict[int, list[str]] = {}
            for row, marker in rows_of(markers, rows["sample"], before, timeline.last):
                texts.setdefault(row, []).append(marker.text)
            for row, line in enumerate(text.getvalue().splitlines()):
                marked = "; ".join(texts.get(row, ())).replace('"', '""')
                table.write(f'{line},"{marked}"\n' if row in texts else f"{line},\n")
            before = int(rows["sample"][-1]) if rows.size else before


def _write_npz(
    file: Path | BinaryIO,
    head: Head,
    pieces: Callable[[], Iterable[NDArray[Any]]],
    summary: dict[str, Any],
    timeline: Timeline,
    markers: Sequence[Marker],
    trials: Sequence[tuple[int, int]],
) -> None:
    """Writes rows column by column, with a chunk of them in memory at a time."""
    _, statistics = read_summary(summary)
    small: dict[str, Any] = {
        "position_scale": head.position_scale,
        "force_scale": head.force_scale,
        "rate": head.rate_hz,
        "report": json.dumps(summary["report"]),
        "clock": json.dumps(head.clock and head.clock._asdict()),
        "trials": np.array(trials, np.int64).reshape(-1, 2),
        **{f"marker_{name}": [getattr(one, name) for one in markers] for name in Marker._fields},
    } | {f"{_COUNTED}{name}": histogram.as_row() for name, histogram in vars(statistics).items()}
    names = (*ROWS, *(LINES if head.lines else ()), *(WORDS if head.words else ()))
    columns: dict[str, tuple[np.dtype[Any], Callable[[Any], NDArray[Any]]]]
    columns = {name: (head.rows[name], itemgetter(name)) for name in names}
    columns["time_s"] = np.dtype("<f8"), lambda rows: timeline.of(rows["sample"], rows["time_ns"])
    count = sum(len(rows) for rows in pieces())
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, (column, values_of) in columns.items():
            about = {"descr": npy.dtype_to_descr(column.base), "fortran_order": False, "shape": (count, *column.shape)}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                npy.write_array_header_1_0(member, about)
                for rows in pieces():
                    member.write(values_of(rows).tobytes())
        for name, value in small.items():
            with archive.open(f"{name}.npy", "w") as member:
                npy.write_array(member, np.asanyarray(value), allow_pickle=False)


def require_writable_as_trace(path: Path) -> None:
    """Raises UsageError if no trace can be written to `path`. Call it before the run."""
    require_writable(path, ".npz", ".csv", ".trace")


def load_trace(path: str | Path) -> Trace:
    """Reads a trace back from a .npz, from a .trace or the .part that a run left which did not come to its end, or from
    a report file, which has its last second. UsageError where the file is none of these, or damaged.

    A file that ends early (a crash, a full disk) is read up to its end; the report's `ending` says so.
    """
    path = Path(path)
    if not path.exists():
        part = path.with_name(f"{path.name}.part")
        left = f". {part} is there, which a run left that did not come to its end" if part.is_file() else ""
        raise UsageError(f"{path}: there is no such file{left}")
    if path.suffix == ".csv":
        raise UsageError(f"{path}: a .csv is for other programs, and is not read back: record a .npz or a .trace")
    if path.is_dir():
        raise UsageError(f"{path}: not a trace that hapsim wrote: found a directory, expected {_EXPECTED}")
    try:
        if is_stream(path):
            return _load_stream(path)
        with path.open("rb") as file:
            return _load_npz(file)
    except UsageError:
        raise
    except PermissionError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # numpy and zipfile raise what they like of a damaged file
        why = "it is neither a .npz nor a stream of rows" if "pickle" in str(error) else str(error)
        if path.stat().st_size == 0:
            why = f"the file is empty; expected {_EXPECTED}"
        elif is_without_end(path):
            why = ZIP_WITHOUT_END
        raise UsageError(f"{path}: not a trace that hapsim wrote ({why})") from error


def is_without_end(path: Path) -> bool:
    """Returns True if a file begins as a zip file (report file, .npz), but the directory at its end is missing. Raises
    OSError if it cannot be read."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PK\x03\x04" and not zipfile.is_zipfile(stream)


def _load_npz(stream: BinaryIO) -> Trace:
    """Reads a .npz, or the one in a report file."""
    if zipfile.is_zipfile(stream):
        with zipfile.ZipFile(stream) as report_file:
            if IN_REPORT in report_file.namelist():
                stream = io.BytesIO(report_file.read(IN_REPORT))
    stream.seek(0)
    with np.load(stream) as file:
        arrays = {name: file[name] for name in file.files if name not in ("rate", "report", "time_s", "clock")}
        counted = {name: arrays.pop(name) for name in list(arrays) if name.startswith(_COUNTED)}
        lines = {name: arrays.pop(name) for name in LINES if name in arrays}
        statistics = Statistics(**{name[len(_COUNTED) :]: Histogram.from_row(row) for name, row in counted.items()})
        report = report_from(json.loads(str(file["report"])))
        rate = float(file["rate"])
        columns = [arrays.pop(f"marker_{name}", np.empty(0)).tolist() for name in Marker._fields]
        markers = tuple(Marker(*one) for one in zip(*columns, strict=True))
        found = json.loads(str(file["clock"])) if "clock" in file.files else None
        trials = tuple(map(tuple, arrays.pop("trials", np.empty((0, 2))).tolist()))
        clock: Clock | None = validated(Clock | None, found)
        return Trace(
            rate=rate,
            statistics=statistics,
            report=report,
            line_counts=lines,
            clock=clock,
            markers=markers,
            trials=trials,
            **arrays,
        )


def _load_stream(path: Path) -> Trace:
    """Reads a stream, up to its end if it is cut short. Raises an error of `NO_RECORD` if it is no trace."""
    reader = StreamReader(path)
    rows = np.concatenate([np.empty(0, reader.head.rows), *reader.rows()])
    report, statistics = read_summary(reader.summary)
    return Trace(
        rate=reader.head.rate_hz,
        **columns_of(rows),
        **words_in(rows),
        position_scale=np.array(reader.head.position_scale),
        force_scale=np.array(reader.head.force_scale),
        statistics=statistics,
        report=report if reader.is_finished else _report_of_rows(report, rows),
        sensed=sensed_in(rows, reader.head.sensed_scale) if reader.head.run else {},  # where it has the scales
        command=commands_in(rows, reader.head.position_scale),
        line_counts=lines_in(rows),
        clock=reader.head.clock,
        markers=markers_of(reader.notes),
        trials=trials_of(reader.notes),
    )


def _report_of_rows(report: Report, rows: NDArray[Any]) -> Report:
    """Returns the report of an unfinished record: counted from the rows as far as possible, the rest as it was last
    written, a second or two before the end."""
    ticks, elapsed = rows.size, 0.0
    if ticks:
        by_clock = float(rows["time_ns"][-1] - rows["time_ns"][0]) * 1e-9
        by_count = float(rows["sample"][-1] - rows["sample"][0]) / report.nominal_rate_hz
        elapsed = by_count if report.virtual_time else by_clock
    return replace(
        report,
        ending=f"{NOT_FINISHED}: the record stops after {ticks} ticks",
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        deadline_misses=int(np.count_nonzero(rows["flags"] & LATE_FORCE)),
        limited_ticks=int(np.count_nonzero(rows["flags"] & LIMITED)),
        released=None,
        rejected_by_device=None,
    )
