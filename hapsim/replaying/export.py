"""A record written for other programs: `hapsim export`."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.background_file import require_writable
from hapsim.recording.trace import convert
from hapsim.replaying.columns import Columns
from hapsim.replaying.replay import Record, Replay
from hapsim.scene.issue import one_of
from hapsim.sound.wav import WavFile, require_writable_as_wav
from hapsim.whole_file import whole_file

_PACKAGES = {".h5": "h5py", ".mcap": "mcap"}
_ENDINGS = (".h5", ".csv", ".npz", ".wav", ".mcap")


def require_exportable(out: Path, column: str | None) -> None:
    """Raises UsageError where no record can be exported to `out`, before it is read. `column`: of a .wav."""
    if out.suffix not in _ENDINGS:
        raise UsageError(f"{out}: found the ending '{out.suffix}', expected {one_of(_ENDINGS)}")
    package = _PACKAGES.get(out.suffix)
    if package is not None and importlib.util.find_spec(package) is None:
        raise UsageError(f"{out}: found no Python package {package}, expected it: pip install 'hapsim[record]'")
    if (column is None) == (out.suffix == ".wav"):
        raise UsageError(
            f"{out}: a .wav has one column, and other files have all: --column goes with a .wav, as in "
            "--column position.0, or the name of a pick-up"
        )
    require_writable(out)


def export(columns: Columns, out: Path, column: str | None, tell: Callable[[float], None]) -> tuple[float, str]:
    """Writes a record as `out`, in constant memory. Returns what a .wav has at full scale, and its unit.

    `column`: of a .wav, such as position.0, or a pick-up. `tell`: is called with the share of the rows that were read.
    Raises UsageError.
    """
    columns.reader.on_rows = lambda rows: tell(rows / columns.count)
    with whole_file(out) as file:
        if column is not None:
            return _write_sound(file, columns, column)
        if out.suffix == ".h5":
            from hapsim.replaying.hdf5_file import write_hdf5

            write_hdf5(file, columns)
        elif out.suffix == ".mcap":
            from hapsim.replaying.mcap_file import write_mcap

            write_mcap(file, columns)
        else:
            convert(columns.reader, file, out.suffix)
    return 0.0, ""


def _write_sound(file: Path, columns: Columns, wanted: str) -> tuple[float, str]:
    """Returns full scale and its unit."""
    of_channels = [column for column in columns.all if column.by_channel]
    each = {name: column for column in of_channels for name in columns.names_of(column, ".")}
    pick_ups = [*columns.scene.sound] if columns.scene else []
    if wanted in pick_ups:
        _write_pick_up(file, columns, wanted)
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


def _write_pick_up(file: Path, columns: Columns, name: str) -> None:
    """At the level of `run --sound-file`."""
    record = Record(columns.path)
    record.reader.on_rows = columns.reader.on_rows
    replay = Replay(record, None, file, name)
    for _ in replay.pieces():
        pass
    replay.close(keeps_part=False)
