"""What happened in a run, tick by tick, and how it ended."""

from __future__ import annotations

import json
import os
import zipfile
import zlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.histogram import Histogram, Spread

_COUNTED = "counted_"  # before the name of a histogram in the file


@dataclass(frozen=True)
class Report:
    """A run in numbers."""

    ending: str
    """Why it ended: done, stopped, …"""
    ticks: int
    duration_s: float
    """From the first position to the last: by the clock on the wall, or in virtual time."""
    rate_hz: float
    """Positions per second of that duration."""
    nominal_rate_hz: float
    """What the scene asks for."""
    deadline_misses: int
    """Samples whose force came too late and for which the one before went on acting."""
    lost_frames: int
    """Positions that never arrived whole."""
    crc_errors: int
    """Frames of the device that the check refused (too short or malformed ones included)."""
    stale_positions: int
    """Positions that a newer one replaced before they could be answered."""
    limited_ticks: int
    """Ticks whose force was cut to its limit."""
    slewed_ticks: int
    """Ticks whose force was brought closer to the one before, by the slew limit or the soft start."""
    withheld_forces: int
    """Times that zero force was sent because the position was older than a force may live."""
    dropped_rows: int
    """Rows missing from the trace because its reader was too slow; the force was not affected."""
    parameter_changes: int
    """Changes of the scene while it ran that were taken: sets of parameters, or another structure."""
    lateness_s: Spread
    """Where the host is the clock: of the loop's wake-up, after the tick was due. Where the device is: of its position,
    after the earliest ones of late, by its own count of samples. Nothing in virtual time."""
    exchange_s: Spread
    """From a position's arrival until its force has left; where the host is the clock, from waking up for the tick
    until the position has arrived, the force sent in between."""
    age_samples: Spread
    """From the position that the acting force answers to the force's change: 1 where it was in time, else at most so
    many, as the device says of a late force only that it was. No force acts for longer than its time to live and one
    sample more; that the force may be zero already is counted as two more."""
    virtual_time: bool
    garbage_bytes: int = 0
    """Bytes from the device, since it was armed, that belonged to no frame."""
    rejected_by_device: int | None = None
    """Frames of the host that the device says it refused since it was armed (register 9); of a device that stopped by
    itself the last one, which disarms, is among them. None where it did not say."""
    released: bool | None = None
    """Whether the device said, after the last force, that it released it; None in a record that does not tell."""
    timed_by_device: bool = False
    estimated_mass_kg: tuple[float | None, ...] = ()
    """Where a correction adapts: for which mass the force of each channel was at the end; None on the others."""
    """Whether a timer of the device's own paced the positions: then their arrival tells its rate."""


@dataclass(frozen=True)
class Statistics:
    """The histograms of which a report tells the quantiles: s, s and samples."""

    lateness: Histogram
    exchange: Histogram
    age: Histogram


@dataclass(frozen=True)
class Trace:
    """N ticks of C channels, in the order in which the positions arrived."""

    rate: float
    """Hz, nominal."""
    sample: NDArray[np.int64]
    """(N,) the device's number of each position, counted from arming."""
    time_ns: NDArray[np.int64]
    """(N,) monotonic time at which it arrived."""
    flags: NDArray[np.uint8]
    """(N,) LATE_FORCE, UNSENT, LIMITED, BRIDGED, OFF_GRID, SLEWED, WITHHELD of hapsim.loop.ring."""
    position_counts: NDArray[np.int32]
    """(N, C) as on the wire."""
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
        rows = ("sample", "time_ns", "flags", "position_counts", "force_counts", "asked_force")
        return replace(self, **{name: getattr(self, name)[tick:] for name in rows})

    def save(self, path: str | Path) -> None:
        """Writes a .npz (every array as it is) or a .csv (SI units). UsageError where it cannot."""
        path = Path(path)
        require_writable_as_trace(path)
        try:
            if path.suffix == ".csv":
                self._save_csv(path)
            else:
                self._save_npz(path)
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {error.strerror or error}") from error

    def _save_npz(self, path: Path) -> None:
        arrays: dict[str, Any] = {name: value for name, value in vars(self).items() if isinstance(value, np.ndarray)}
        counted = {f"{_COUNTED}{name}": histogram.as_row() for name, histogram in vars(self.statistics).items()}
        np.savez_compressed(path, rate=self.rate, report=json.dumps(asdict(self.report)), **arrays, **counted)

    def _save_csv(self, path: Path) -> None:
        channels = range(self.position_scale.size)
        names = [f"{what}[{c}]" for what in ("position_m", "force_N", "asked_force_N") for c in channels]
        table = np.column_stack([self.sample, self.time_ns, self.flags, self.position, self.force, self.asked_force])
        formats = ["%d", "%d", "%d"] + ["%.12g"] * (3 * len(channels))
        header = ",".join(["sample", "time_ns", "flags", *names])
        np.savetxt(path, table, fmt=formats, delimiter=",", header=header, comments="")


def require_writable_as_trace(path: Path) -> None:
    """UsageError where a trace could not be written there: better before the run than after it."""
    if path.suffix not in (".npz", ".csv"):
        raise UsageError(f"{path}: a trace is written as .npz or .csv, by the file's ending")
    if not path.resolve().parent.is_dir():
        raise UsageError(f"{path}: there is no directory {path.resolve().parent}")
    if path.is_dir() or not os.access(path if path.exists() else path.resolve().parent, os.W_OK):
        raise UsageError(f"{path}: no file can be written there")


def load_trace(path: str | Path) -> Trace:
    """Reads a trace back from a .npz. UsageError where the file is none."""
    try:
        with Path(path).open("rb") as stream, np.load(stream) as file:  # numpy leaves a torn file open
            arrays = {name: file[name] for name in file.files if name not in ("rate", "report")}
            counted = {name: arrays.pop(name) for name in list(arrays) if name.startswith(_COUNTED)}
            statistics = Statistics(**{name[len(_COUNTED) :]: Histogram.from_row(row) for name, row in counted.items()})
            report = _report(json.loads(str(file["report"])))
            return Trace(rate=float(file["rate"]), statistics=statistics, report=report, **arrays)
    except (OSError, EOFError, ValueError, KeyError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise UsageError(f"{path}: not a trace that hapsim wrote ({error})") from error


def _report(values: dict[str, Any]) -> Report:
    for name in ("lateness_s", "exchange_s", "age_samples"):
        values[name] = Spread(**values[name])
    values["estimated_mass_kg"] = tuple(values.get("estimated_mass_kg", ()))
    return Report(**({"slewed_ticks": 0, "withheld_forces": 0} | values))  # of a record from before there were any
