"""A trace as a stream of rows on disk: read back, written in one go, turned into other files without having all of it
in memory."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram
from hapsim.loop.ring import LATE_FORCE, LIMITED
from hapsim.loop.stream import MOST_ROWS, Head, StreamReader, StreamWriter, row_type
from hapsim.loop.trace import ROWS, Report, Statistics, Trace, beside_the_rows, report_from, write_csv


def as_told(report: Report, statistics: Statistics, finished: bool) -> dict[str, Any]:
    """What a stream tells of a run beside its rows, for JSON."""
    return {
        "finished": finished,
        "report": asdict(report),
        "histograms": {name: _sparse(histogram) for name, histogram in vars(statistics).items()},
    }


def as_rows(columns: Sequence[NDArray[Any]], channels: int) -> NDArray[Any]:
    """Rows of a stream out of a trace's columns, in the order of ROWS."""
    rows = np.empty(len(columns[0]), row_type(channels))
    for name, column in zip(ROWS, columns, strict=True):
        rows[name] = column
    return rows


def save_stream(trace: Trace, path: Path) -> None:
    """OSError where it cannot be written."""
    head = Head(trace.rate, trace.position_scale.tolist(), trace.force_scale.tolist())
    told = as_told(trace.report, trace.statistics, True)
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
    writer = StreamWriter(descriptor, head, told)
    try:
        for first in range(0, trace.sample.size, MOST_ROWS):
            columns = [getattr(trace, name)[first : first + MOST_ROWS] for name in ROWS]
            writer.rows(as_rows(columns, head.channels))
        writer.tell(told)
    finally:
        writer.close()


def load_stream(path: Path) -> Trace:
    """UsageError where it has not even a beginning. Of one that was cut off, everything up to there."""
    try:
        reader = StreamReader(path)
        all_rows = np.empty(reader.count(), row_type(reader.head.channels))
        at = 0
        for rows in reader.rows():  # which may have grown meanwhile, where it is being written
            taken = rows[: len(all_rows) - at]
            all_rows[at : at + len(taken)] = taken
            at += len(taken)
        return _trace_of(reader, all_rows[:at])
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path}: not a trace that hapsim wrote ({error})") from error


def convert(part: Path, path: Path) -> None:
    """Writes the stream `part` of a run that came to its end as a .npz or .csv. Of the rows, no more than a chunk is in
    memory at once. OSError where it cannot be written."""
    reader = StreamReader(part)
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8") as file:
            write_csv(file, (_trace_of(reader, rows) for rows in reader.rows()), reader.head.channels)
    else:
        _convert_to_npz(reader, path)


def _convert_to_npz(reader: StreamReader, path: Path) -> None:
    """Column by column, so that each is written as it is read."""
    count, head = reader.count(), reader.head
    report, statistics = _what_was_told(reader)
    small: dict[str, Any] = {"position_scale": np.array(head.position_scale), "force_scale": np.array(head.force_scale)}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as file:
        for name in ROWS:
            column = row_type(head.channels)[name]
            about = {"descr": npy.dtype_to_descr(column.base), "fortran_order": False, "shape": (count, *column.shape)}
            with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                npy.write_array_header_1_0(member, about)
                for rows in reader.rows():
                    member.write(rows[name].tobytes())
        for name, value in (small | beside_the_rows(head.rate_hz, statistics, report)).items():
            with file.open(f"{name}.npy", "w") as member:
                npy.write_array(member, np.asanyarray(value), allow_pickle=False)


def _trace_of(reader: StreamReader, rows: NDArray[Any]) -> Trace:
    report, statistics = _what_was_told(reader)
    columns = {name: np.ascontiguousarray(rows[name]) for name in ROWS}
    trace = Trace(
        rate=reader.head.rate_hz,
        position_scale=np.array(reader.head.position_scale),
        force_scale=np.array(reader.head.force_scale),
        statistics=statistics,
        report=report,
        **columns,
    )
    return trace if reader.is_finished else replace(trace, report=_cut_off(trace))


def _what_was_told(reader: StreamReader) -> tuple[Report, Statistics]:
    histograms = {name: _whole(one) for name, one in reader.told["histograms"].items()}
    return report_from(reader.told["report"]), Statistics(**histograms)


def _cut_off(trace: Trace) -> Report:
    """The report of a run whose record does not come to an end: what the rows tell is of the rows, the rest as it was
    told last, a second before at most."""
    ticks = trace.sample.size
    elapsed = 0.0
    if ticks:
        by_clock = float(trace.time_ns[-1] - trace.time_ns[0]) * 1e-9
        elapsed = float(trace.sample[-1] - trace.sample[0]) / trace.rate if trace.report.virtual_time else by_clock
    return replace(
        trace.report,
        ending=f"not finished: the record stops after {ticks} ticks",
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        deadline_misses=int(np.count_nonzero(trace.flags & LATE_FORCE)),
        limited_ticks=int(np.count_nonzero(trace.flags & LIMITED)),
        released=None,
        rejected_by_device=None,
    )


def _sparse(histogram: Histogram) -> dict[str, Any]:
    """The bins in which something was counted."""
    bins = np.flatnonzero(histogram.counts)
    counted = [bins.tolist(), histogram.counts[bins].tolist()]
    return {"unit": histogram.unit, "maximum": histogram.maximum, "bins": histogram.counts.size, "counted": counted}


def _whole(sparse: dict[str, Any]) -> Histogram:
    counts = np.zeros(sparse["bins"], np.int64)
    bins, counted = sparse["counted"]
    counts[np.array(bins, np.int64)] = counted
    return Histogram(counts, sparse["maximum"], sparse["unit"])
