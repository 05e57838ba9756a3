"""The file format of a trace under way, readable even after its writer was killed.

    "hapsim trace\\r\\n\\x1a\\n"                          16 bytes
    a chunk: kind, 4 bytes; count, size and check, 4 bytes each, little-endian; payload, `size` bytes
    and so on

The check is a CRC-32 (zlib's) of everything else in the chunk. HEAD, the first: a JSON document (version, channels,
the fields of `Head`, and the report before the first row). ROWS: `count` rows of `Head.rows`. NOTE: a JSON document,
what happened beside the rows: a marker, a detent's new place, or a change of the scene and the first tick with it; at
the end of a run, what was predicted of its scene. TOLD, about once a second and at the end: a JSON document, the report
and the histograms so far; `finished` is true in the last one of a run that came to its end. A reader stops at the first
chunk that is not whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from firmware_protocol import schema
from hapsim.errors import UsageError
from hapsim.loop.ring import SENSED, row_type
from hapsim.recording.report import NO_RECORD, read_summary, validated
from hapsim.recording.times import Clock, Timeline

MAGIC = b"hapsim trace\r\n\x1a\n"
VERSION = 6
_READ = (1, 2, 3, 4, 5, 6)  # 1: no `run`, no notes; 2: no accelerations; 3: no lines; 4: no words; 5: no points away,
# no sensed forces
MOST_ROWS = 1 << 12
"""Largest number of rows in a chunk: a reader has them in memory at once, and a full disk loses them together."""

_CHUNK = struct.Struct("<4sIII")
_HEAD, _ROWS, _NOTE, _SUMMARY = b"HEAD", b"ROWS", b"NOTE", b"TOLD"
_MOST_BYTES = 1 << 26  # of a chunk; one that says it is longer is damaged


# So that its products with counts and with another are numbers, too.
_AboveZero = Annotated[float, Field(gt=1e-100, lt=1e100)]
_Scales = Annotated[list[_AboveZero], Field(min_length=1, max_length=schema.MAX_CHANNELS)]


class Head(NamedTuple):
    """Properties of the whole file."""

    rate_hz: _AboveZero
    position_scale: _Scales
    """m per count, by channel."""
    force_scale: _Scales
    """N per count, by channel."""
    scene: str = ""
    """The scene's file, or ""."""
    begun: str = ""
    """UTC, ISO 8601."""
    velocity: bool = False
    """True if its rows have the velocities that the device sensed."""
    acceleration: bool = False
    """Likewise, the accelerations."""
    hand_force: bool = False
    """Likewise, the forces of the hand (`mode: admittance`); its rows then have the commanded positions, too."""
    lines: bool = False
    """True if the device followed lines (`law: board`); its rows then have them."""
    words: bool = False
    """True if a digital word each way was on the wire; its rows then have them."""
    away: int = 0
    """Number of points at other ports in its rows."""
    by_host: bool = False
    """True if the host paced the run; its rows then have the times at which forces left."""
    clock: Clock | None = None
    """The clock of its arrivals; None in a record of an earlier version."""
    run: dict[str, Any] | None = None
    """The run (`hapsim.running.recorded_run`); None if the record cannot be replayed."""

    @property
    def rows(self) -> np.dtype[Any]:
        """The type of its rows."""
        return row_type(self.channels, self.sensed, self.by_host, self.lines, self.words, self.away)

    @property
    def sensed(self) -> tuple[str, ...]:
        """Names of what its rows have beside the positions, of SENSED."""
        return tuple(name for name in SENSED if getattr(self, name))

    def sensed_scale(self, name: str) -> list[float]:
        """Returns the scales of a name of `sensed`, SI units per count, by channel."""
        scale: list[float] = (self.run or {})["description"][f"{name}_scale"]
        return scale

    @property
    def channels(self) -> int:
        """Number of the device's channels."""
        return len(self.position_scale)


class StreamWriter:
    """Writes chunks, each in one go: a reader cuts a file that ends within one there."""

    def __init__(self, descriptor: int, head: Head, summary: dict[str, Any]) -> None:
        """`descriptor`: of an empty file, which becomes this object's to close; `summary`: report and histograms before
        there are rows. OSError where nothing can be written."""
        self.written = 0
        """Rows so far."""
        self._descriptor, self._end = descriptor, 0
        clock = head.clock and head.clock._asdict()
        whole = {"version": VERSION, "channels": head.channels, **head._asdict(), "clock": clock, "told": summary}
        try:
            self._write(MAGIC)
            self._write_chunk(_HEAD, 0, json.dumps(whole).encode())
        except OSError:
            os.close(descriptor)
            raise

    def write_rows(self, rows: NDArray[Any]) -> None:
        """Writes rows of `row_type`. OSError where not all could be written: then as many chunks as there is room for
        are."""
        for begin in range(0, len(rows), MOST_ROWS):
            piece = rows[begin : begin + MOST_ROWS]
            self._write_chunk(_ROWS, len(piece), piece.tobytes())
            self.written += len(piece)

    def write_note(self, note: dict[str, Any]) -> None:
        """Writes a note. Raises OSError if it cannot."""
        self._write_chunk(_NOTE, 0, json.dumps(note).encode())

    def write_summary(self, summary: dict[str, Any]) -> None:
        """Writes the report and the histograms so far, and flushes the file to the disk. OSError where it cannot."""
        self._write_chunk(_SUMMARY, 0, json.dumps(summary).encode())
        os.fsync(self._descriptor)

    def close(self) -> None:
        """Closes the file; what was written stays."""
        os.close(self._descriptor)

    def _write_chunk(self, kind: bytes, count: int, payload: bytes) -> None:
        check = zlib.crc32(payload, zlib.crc32(kind + struct.pack("<II", count, len(payload))))
        self._write(_CHUNK.pack(kind, count, len(payload), check) + payload)

    def _write(self, data: bytes) -> None:
        """Writes all of `data`, or restores the length of the file and raises OSError."""
        left = memoryview(data)
        try:
            while left:
                left = left[os.write(self._descriptor, left) :]
        except OSError:
            with contextlib.suppress(OSError):
                os.ftruncate(self._descriptor, self._end)
                os.lseek(self._descriptor, self._end, os.SEEK_SET)
            raise
        self._end += len(data)


class StreamReader:
    """Reads such a file, any number of times. Raises UsageError if it is none."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with reading(path):
            self._read_head(path)
        self.notes: list[dict[str, Any]] = []
        """The notes, once the rows were read."""
        self.is_finished = False
        """True if the run ended and its record is complete, once the rows were read."""
        self.count = 0
        """The number of its rows, once they were read."""
        self._end: int | None = None  # where reading stops in a file that still grows
        self.on_rows: Callable[[int], None] = lambda _: None
        """Called with the number of rows read so far."""

    def _read_head(self, path: Path) -> None:
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                wanted = "expected a .trace, as `hapsim run SCENE --record FILE.trace` writes it"
                raise UsageError(f"{path}: not a trace that hapsim wrote; {wanted}")
            kind, _, payload = _next_chunk(stream) or (b"", 0, b"")
            if kind != _HEAD:
                raise UsageError(f"{path}: the trace was cut off, or damaged, before its first row")
            self._begin = stream.tell()
        head = json.loads(payload)
        if head["version"] not in _READ:
            raise UsageError(
                f"{path}: found version {head['version']} of hapsim's stream of rows, expected {VERSION}: it takes a "
                "newer hapsim"
            )
        self.head: Head = validated(Head, {name: head[name] for name in Head._fields if name in head})
        if len(self.head.force_scale) != self.head.channels:
            raise ValueError(f"found {len(self.head.force_scale)} force scales, expected {self.head.channels}")
        self.summary: dict[str, Any] = head["told"]
        """The last report and histograms in the file, once the rows were read."""
        read_summary(self.summary)

    def rows(self) -> Iterator[NDArray[Any]]:
        """Yields the rows of all chunks up to the first incomplete one. Raises UsageError for a damaged one."""
        with reading(self._path):
            yield from self._rows()

    def timeline(self) -> Timeline:
        """Reads all rows, and returns their times."""
        report, _ = read_summary(self.summary)
        return Timeline(self.head.rate_hz, report, ((one["sample"], one["time_ns"]) for one in self.rows()))

    def _rows(self) -> Iterator[NDArray[Any]]:
        kind, of = b"", self.head.rows
        self.notes, self.count = [], 0
        with self._path.open("rb") as stream:
            end = stream.seek(self._begin)
            while end != self._end and (chunk := _next_chunk(stream)):
                kind, count, payload = chunk
                if kind == _ROWS:
                    if len(payload) != count * of.itemsize:
                        break
                    self.count += count
                    yield np.frombuffer(payload, of)
                    self.on_rows(self.count)
                elif kind == _NOTE:
                    self.notes.append(validated(dict[str, Any], json.loads(payload)))
                elif kind == _SUMMARY:
                    self.summary = json.loads(payload)
                end = stream.tell()
            is_all = end == stream.seek(0, os.SEEK_END)
            self._end = end
        read_summary(self.summary)
        self.is_finished = bool(self.summary["finished"]) and kind == _SUMMARY and is_all


def open_record(path: Path) -> StreamReader:
    """Returns a reader that has read all rows once, so that their count, the notes and the summary are known.
    UsageError where the file is no record, is damaged, or has no rows."""
    if not path.is_file():
        raise UsageError(f"{path}: found no file, expected a .trace that `hapsim run --record` wrote")
    reader = StreamReader(path)
    for _ in reader.rows():
        pass
    if not reader.count:
        raise UsageError(f"{path}: found a record without rows, expected some: the run ended before its first")
    return reader


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Raises UsageError if the file read in this context is unreadable or damaged."""
    try:
        yield
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from error
    except NO_RECORD as error:
        raise UsageError(f"{path}: the record is damaged: {error}") from error


def is_stream(path: Path) -> bool:
    """Returns True if the file begins as a stream. Raises OSError if it cannot be read."""
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def _next_chunk(stream: BinaryIO) -> tuple[bytes, int, bytes] | None:
    """Returns kind, count and payload of the next chunk; None if no complete one follows."""
    head = stream.read(_CHUNK.size)
    if len(head) < _CHUNK.size:
        return None
    kind, count, size, check = _CHUNK.unpack(head)
    left = os.fstat(stream.fileno()).st_size - stream.tell()
    payload = stream.read(size) if size <= min(_MOST_BYTES, left) else b""
    whole = len(payload) == size and zlib.crc32(payload, zlib.crc32(head[:12])) == check
    return (kind, count, payload) if whole else None
