"""A trace as a stream of rows on disk: read back, written in one go, turned into other files without having all of it
in memory."""

from __future__ import annotations

import os
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import LATE_FORCE, LIMITED
from hapsim.recording.report import DAMAGED, NOT_FINISHED, Report, beside_the_rows, from_told
from hapsim.recording.stream import MOST_ROWS, ROWS, Head, StreamReader, StreamWriter, row_type


def as_rows(columns: Sequence[NDArray[Any]], channels: int) -> NDArray[Any]:
    """Rows of a stream out of a trace's columns, in the order of ROWS."""
    rows = np.empty(len(columns[0]), row_type(channels))
    for name, column in zip(ROWS, columns, strict=True):
        rows[name] = column
    return rows


def save_stream(path: Path, head: Head, columns: Mapping[str, NDArray[Any]], told: dict[str, Any]) -> None:
    """Writes a whole trace as one. OSError where it cannot be written."""
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | getattr(os, "O_BINARY", 0), 0o666)
    writer = StreamWriter(descriptor, head, told)
    try:
        for first in range(0, columns["sample"].size, MOST_ROWS):
            piece = [columns[name][first : first + MOST_ROWS] for name in ROWS]
            writer.rows(as_rows(piece, head.channels))
        writer.tell(told)
    finally:
        writer.close()


def load_stream(path: Path) -> dict[str, Any]:
    """What a Trace consists of, by the names of its fields. UsageError where the file has not even a beginning. Of one
    that was cut off, everything up to there."""
    try:
        reader = StreamReader(path)
        all_rows = np.empty(reader.count(), row_type(reader.head.channels))
        at = 0
        for rows in reader.rows():  # which may have grown meanwhile, where it is being written
            taken = rows[: len(all_rows) - at]
            all_rows[at : at + len(taken)] = taken
            at += len(taken)
        report, statistics = from_told(reader.told)
    except (KeyError, TypeError, ValueError) as error:
        raise UsageError(f"{path}: not a trace that hapsim wrote ({error})") from error
    all_rows = all_rows[:at]
    return {name: np.ascontiguousarray(all_rows[name]) for name in ROWS} | {
        "rate": reader.head.rate_hz,
        "position_scale": np.array(reader.head.position_scale),
        "force_scale": np.array(reader.head.force_scale),
        "statistics": statistics,
        "report": report if reader.is_finished else _cut_off(report, all_rows, reader),
    }


def convert(part: Path, path: Path) -> None:
    """Writes the stream `part` of a run that came to its end as a .npz or .csv. Of the rows, no more than a chunk is in
    memory at once. OSError where it cannot be written."""
    reader = StreamReader(part)
    if path.suffix == ".csv":
        with path.open("w", encoding="utf-8") as file:
            write_csv(file, reader.head, reader.rows())
    else:
        _convert_to_npz(reader, path)


def write_csv(file: TextIO, head: Head, pieces: Iterable[Any]) -> None:
    """Writes rows as a table, in SI units. `pieces`: each has the columns of ROWS, by name."""
    each = range(head.channels)
    names = [f"{what}[{c}]" for what in ("position_m", "force_N", "asked_force_N") for c in each]
    formats = ["%d", "%d", "%d"] + ["%.12g"] * (3 * head.channels)
    file.write(",".join(["sample", "time_ns", "flags", *names]) + "\n")
    for rows in pieces:
        position = rows["position_counts"] * np.array(head.position_scale)
        force = rows["force_counts"] * np.array(head.force_scale)
        table = np.column_stack([rows["sample"], rows["time_ns"], rows["flags"], position, force, rows["asked_force"]])
        np.savetxt(file, table, fmt=formats, delimiter=",")


def _convert_to_npz(reader: StreamReader, path: Path) -> None:
    """Column by column, so that each is written as it is read."""
    count, head = reader.count(), reader.head
    report, statistics = from_told(reader.told)
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


def _cut_off(report: Report, rows: NDArray[Any], reader: StreamReader) -> Report:
    """The report of a run whose record does not come to an end: what the rows tell is of the rows, the rest as it was
    told last, a second before or two."""
    ticks = rows.size
    elapsed = 0.0
    if ticks:
        by_clock = float(rows["time_ns"][-1] - rows["time_ns"][0]) * 1e-9
        by_count = float(rows["sample"][-1] - rows["sample"][0]) / report.nominal_rate_hz
        elapsed = by_count if report.virtual_time else by_clock
    return replace(
        report,
        ending=_where_it_stops(ticks, reader),
        ticks=ticks,
        duration_s=elapsed,
        rate_hz=(ticks - 1) / elapsed if elapsed > 0 else 0.0,
        deadline_misses=int(np.count_nonzero(rows["flags"] & LATE_FORCE)),
        limited_ticks=int(np.count_nonzero(rows["flags"] & LIMITED)),
        released=None,
        rejected_by_device=None,
    )


def _where_it_stops(ticks: int, reader: StreamReader) -> str:
    if reader.damaged_at is None:
        return f"{NOT_FINISHED}: the record stops after {ticks} ticks"
    left_out = f"not read: the last {_size(reader.unread_bytes)}"
    return f"{DAMAGED} behind byte {reader.damaged_at}: {ticks} ticks read; {left_out}"


def _size(count: int) -> str:
    for unit, name in ((10**9, "GB"), (10**6, "MB"), (10**3, "kB")):
        if count >= unit:
            return f"{count / unit:.1f} {name}"
    return f"{count} byte" + "s" * (count != 1)
