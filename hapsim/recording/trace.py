"""Trace: the samples of a run, tick by tick, with its report."""

from __future__ import annotations

import io
import json
import os
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
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
    lines_in,
    sensed_in,
    words_in,
)
from hapsim.recording.background_file import require_writable
from hapsim.recording.report import NOT_FINISHED, Report, Statistics, read_summary, report_from, summary_document
from hapsim.recording.stream import Head, StreamReader, StreamWriter, is_stream
from hapsim.scene.load import recorded_scene

IN_REPORT = "trace.npz"
"""A trace's name in a report file."""
ZIP_WITHOUT_END = "a zip file that was cut short, or damaged at its end: get a whole copy of it"

_COUNTED = "counted_"  # before the name of a histogram in a .npz
_ENDINGS = (".npz", ".csv", ".trace")
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
    """(N, C) of each value that the device sent beside its positions: "velocity", m/s, "acceleration", m/s². `save`
    does not write them; a .trace that `hapsim run --record` writes has them."""

    line_counts: dict[str, NDArray[Any]] = field(default_factory=dict)
    """(N, C) of each of LINES of hapsim.loop.ring, if the device follows lines (`law: board`): "acted_force", N, and
    the line that answers each position, in counts."""

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

    def since(self, tick: int) -> Trace:
        """Returns the rows from this tick on, with the same report."""
        sensed, lines = ({k: v[tick:] for k, v in of.items()} for of in (self.sensed, self.line_counts))
        cut = {name: getattr(self, name)[tick:] for name in (*ROWS, *WORDS)}
        return replace(self, sensed=sensed, line_counts=lines, **cut)

    def save(self, path: str | Path) -> None:
        """Writes a .npz or .trace (unchanged arrays) or a .csv (SI units). Raises UsageError if it cannot."""
        path = Path(path)
        require_writable_as_trace(path)
        try:
            if path.suffix == ".npz":
                self.write_npz(path)
            elif path.suffix == ".csv":
                _write_csv(path, *self._head_and_rows)
            else:
                self._write_stream(path)
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {error.strerror or error}") from error

    def write_npz(self, file: Path | BinaryIO) -> None:
        """Writes a .npz. Raises OSError if it cannot."""
        head, rows = self._head_and_rows
        _write_npz(file, head, lambda: rows, self.sample.size, summary_document(self.report, self.statistics, True))

    def _write_stream(self, path: Path) -> None:
        head, (rows,) = self._head_and_rows
        summary = summary_document(self.report, self.statistics, True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0)
        writer = StreamWriter(os.open(path, flags, 0o666), head, summary)
        try:
            writer.write_rows(rows)
            writer.write_summary(summary)
        finally:
            writer.close()

    @property
    def _head_and_rows(self) -> tuple[Head, list[NDArray[Any]]]:
        scales, has_words = (self.position_scale.tolist(), self.force_scale.tolist()), bool(self.inputs.size)
        head = Head(self.rate, *scales, lines=bool(self.line_counts), words=has_words)
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
    if ending == ".csv":
        _write_csv(file, reader.head, reader.rows())
    else:
        count = sum(len(rows) for rows in reader.rows())
        _write_npz(file, reader.head, reader.rows, count, reader.summary)


def _write_csv(file: Path, head: Head, pieces: Iterable[NDArray[Any]]) -> None:
    """Writes rows as a table, in SI units."""
    each = range(head.channels)
    names = [f"{what}[{c}]" for what in ("position_m", "force_N", "asked_force_N") for c in each] + ["time_s"]
    scene = recorded_scene(head.run["scene"], str(file)) if head.words and head.run else None
    named = scene.word_values(0, 0) if scene else {}
    names += [*(WORDS if head.words else ()), *named]
    formats = ["%d", "%d", "%d"] + ["%.12g"] * (3 * head.channels + 1) + ["%d"] * (2 * head.words + len(named))
    with file.open("w", encoding="utf-8") as table:
        table.write(",".join(["sample", "time_ns", "flags", *names]) + "\n")
        for rows in pieces:
            position = rows["position_counts"] * np.array(head.position_scale)
            force = rows[ACTED] if head.lines else rows["force_counts"] * np.array(head.force_scale)
            columns = [rows["sample"], rows["time_ns"], rows["flags"], position, force, rows["asked_force"]]
            columns += [rows["sample"] / head.rate_hz, *(words := words_in(rows)).values()]
            columns += scene.word_values(**words).values() if scene else ()
            np.savetxt(table, np.column_stack(columns), fmt=formats, delimiter=",")


def _write_npz(
    file: Path | BinaryIO, head: Head, pieces: Callable[[], Iterable[NDArray[Any]]], count: int, summary: dict[str, Any]
) -> None:
    """Writes `count` rows column by column, with a chunk of rows in memory at a time."""
    _, statistics = read_summary(summary)
    small: dict[str, Any] = {
        "position_scale": head.position_scale,
        "force_scale": head.force_scale,
        "rate": head.rate_hz,
        "report": json.dumps(summary["report"]),
    } | {f"{_COUNTED}{name}": histogram.as_row() for name, histogram in vars(statistics).items()}
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name in (*ROWS, *(LINES if head.lines else ()), *(WORDS if head.words else ())):
            column = head.rows[name]
            about = {"descr": npy.dtype_to_descr(column.base), "fortran_order": False, "shape": (count, *column.shape)}
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                npy.write_array_header_1_0(member, about)
                for rows in pieces():
                    member.write(rows[name].tobytes())
        for name, value in small.items():
            with archive.open(f"{name}.npy", "w") as member:
                npy.write_array(member, np.asanyarray(value), allow_pickle=False)


def require_writable_as_trace(path: Path) -> None:
    """Raises UsageError if no trace can be written to `path`. Call it before the run."""
    if path.suffix not in _ENDINGS:
        raise UsageError(f"{path}: found the ending '{path.suffix}', expected {', '.join(_ENDINGS)}")
    require_writable(path)


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
        arrays = {name: file[name] for name in file.files if name not in ("rate", "report")}
        counted = {name: arrays.pop(name) for name in list(arrays) if name.startswith(_COUNTED)}
        lines = {name: arrays.pop(name) for name in LINES if name in arrays}
        statistics = Statistics(**{name[len(_COUNTED) :]: Histogram.from_row(row) for name, row in counted.items()})
        report = report_from(json.loads(str(file["report"])))
        rate = float(file["rate"])
        return Trace(rate=rate, statistics=statistics, report=report, line_counts=lines, **arrays)


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
        line_counts=lines_in(rows),
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
