"""What happened in a run, tick by tick, and how it ended."""

from __future__ import annotations

import io
import json
import os
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.recording.report import COUNTED, Report, Statistics, as_told, beside_the_rows, report_from
from hapsim.recording.stream import ROWS, Head, is_stream
from hapsim.recording.streamed_trace import load_stream, save_stream, write_csv

IN_REPORT = "trace.npz"
"""A trace's name in a report file."""


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
    """(N, C) N, what the scene's modules asked for: before an excitation, the limit and the rounding to counts."""
    position_scale: NDArray[np.float64]
    """(C,) m per count."""
    force_scale: NDArray[np.float64]
    """(C,) N per count."""
    statistics: Statistics
    report: Report

    def __repr__(self) -> str:
        samples = f" (samples {self.sample[0]} to {self.sample[-1]})" if self.sample.size else ""
        return (
            f"Trace({self.sample.size} rows{samples}, channels={self.position_scale.size}, rate={self.rate:g}, "
            f"ending={self.report.ending!r})"
        )

    @property
    def position(self) -> NDArray[np.float64]:
        """(N, C) m."""
        return self.position_counts * self.position_scale

    @property
    def force(self) -> NDArray[np.float64]:
        """(N, C) N."""
        return self.force_counts * self.force_scale

    def since(self, tick: int) -> Trace:
        """Its rows from this tick on, with the same report."""
        return replace(self, **{name: getattr(self, name)[tick:] for name in ROWS})

    def save(self, path: str | Path) -> None:
        """Writes a .npz or a .trace (every array as it is) or a .csv (SI units). UsageError where it cannot."""
        path = Path(path)
        require_writable_as_trace(path)
        head = Head(self.rate, self.position_scale.tolist(), self.force_scale.tolist())
        columns = {name: getattr(self, name) for name in ROWS}
        try:
            if path.suffix == ".csv":
                with path.open("w", encoding="utf-8") as file:
                    write_csv(file, head, [columns])
            elif path.suffix == ".trace":
                save_stream(path, head, columns, as_told(self.report, self.statistics, True))
            else:
                self.write_npz(path)
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {error.strerror or error}") from error

    def write_npz(self, file: Path | BinaryIO) -> None:
        """OSError where it cannot be written."""
        arrays: dict[str, Any] = {name: getattr(self, name) for name in (*ROWS, "position_scale", "force_scale")}
        np.savez_compressed(file, **arrays, **beside_the_rows(self.rate, self.statistics, self.report))


def require_writable_as_trace(path: Path) -> None:
    """UsageError where a trace could not be written there: better before the run than after it."""
    if path.suffix not in ENDINGS:
        raise UsageError(f"{path}: a trace is written as {one_of_endings()}, by the file's ending")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    is_other = path.exists() and not path.is_file() and not path.is_char_device()  # a pipe would keep us waiting
    if is_other or not os.access(path if path.exists() else path.resolve().parent, os.W_OK):
        raise UsageError(f"{path}: no file can be written there")


ENDINGS = (".npz", ".csv", ".trace")


def one_of_endings() -> str:
    """In words."""
    return f"{', '.join(ENDINGS[:-1])} or {ENDINGS[-1]}"


def load_trace(path: str | Path) -> Trace:
    """Reads a trace back from a .npz, from a .trace or the .part that a run left which did not come to its end, or from
    a report file, which has its last second. UsageError where the file is none of these, or damaged.

    Of a file that was cut off (a crash, a full disk) everything up to there is read; the report's `ending` says so.
    """
    path = Path(path)
    if not path.exists():
        beside = path.with_name(f"{path.name}.part")
        left = f". {beside} is there, which a run left that did not come to its end" if beside.is_file() else ""
        raise UsageError(f"{path}: there is no such file{left}")
    if path.suffix == ".csv":
        raise UsageError(f"{path}: a .csv is for other programs, and is not read back: record a .npz or a .trace")
    if path.is_dir():
        raise UsageError(f"{path}: not a trace that hapsim wrote: found a directory, expected {_EXPECTED}")
    try:
        if is_stream(path):
            trace = Trace(**load_stream(path))
        else:
            with path.open("rb") as stream:
                trace = _load_npz(_within_report(stream))
        _require_consistent(trace)
    except UsageError:
        raise
    except PermissionError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror}") from error
    except Exception as error:  # numpy and zipfile raise what they like of a damaged file
        raise UsageError(f"{path}: not a trace that hapsim wrote ({_why_none(path, error)})") from error
    return trace


_EXPECTED = "a .npz or .trace, what is left of one (.part), or a report file"


def _why_none(path: Path, error: Exception) -> str:
    """What is wrong with a file that could be read, and is no trace."""
    if path.stat().st_size == 0:
        return f"the file is empty; expected {_EXPECTED}"
    if is_without_end(path):
        return ZIP_WITHOUT_END
    return "it is neither a .npz nor a stream of rows" if "pickle" in str(error) else str(error)


def _require_consistent(trace: Trace) -> None:
    """ValueError where no run has such rows, or no device such numbers."""
    rows, channels = trace.sample.size, trace.position_scale.size
    for name in ROWS:
        column = getattr(trace, name)
        expected = (rows,) if name in ("sample", "time_ns", "flags") else (rows, channels)
        if column.shape != expected:
            raise ValueError(f"{name}: found {column.shape}, expected {expected}")
        if column.dtype.kind not in ("f" if name == "asked_force" else "iu"):
            raise ValueError(f"{name}: found {column.dtype}")
    for name in ("rate", "position_scale", "force_scale"):
        value = np.asarray(getattr(trace, name))
        if value.shape not in ((), (channels,)) or not np.all(np.isfinite(value) & (value > 0)):
            raise ValueError(f"{name}: found {value.tolist()}, expected numbers above 0, one for each channel")


ZIP_WITHOUT_END = "a zip file that was cut short, or damaged at its end: get a whole copy of it"


def is_without_end(path: Path) -> bool:
    """Whether a file begins as a zip file, as a report file and a .npz do, and its directory, which stands at the end,
    cannot be found. OSError where it cannot be read."""
    with path.open("rb") as stream:
        return stream.read(4) == b"PK\x03\x04" and not zipfile.is_zipfile(stream)


def _within_report(stream: BinaryIO) -> BinaryIO:
    """The .npz in a report file; any other file as it is."""
    if not zipfile.is_zipfile(stream):
        stream.seek(0)
        return stream
    with zipfile.ZipFile(stream) as file:
        if IN_REPORT in file.namelist():
            return io.BytesIO(file.read(IN_REPORT))
    stream.seek(0)
    return stream


def _load_npz(stream: BinaryIO) -> Trace:
    with np.load(stream) as file:
        arrays = {name: file[name] for name in file.files if name not in ("rate", "report")}
        counted = {name: arrays.pop(name) for name in list(arrays) if name.startswith(COUNTED)}
        statistics = Statistics(**{name[len(COUNTED) :]: Histogram.from_row(row) for name, row in counted.items()})
        report = report_from(json.loads(str(file["report"])))
        return Trace(rate=float(file["rate"]), statistics=statistics, report=report, **arrays)
