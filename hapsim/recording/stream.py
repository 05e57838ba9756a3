"""The file that a trace is written to while it runs: what is in it can be read whatever became of its writer.

    "hapsim trace\\r\\n\\x1a\\n"                          16 bytes
    a chunk: kind, 4 bytes; count, size and check, 4 bytes each, little-endian; payload, `size` bytes
    and so on

The check is a CRC-32 (zlib's) of everything else in the chunk. HEAD, the first: a JSON document (version, rate_hz,
channels, position_scale, force_scale, scene, begun, and the report before the first row). ROWS: `count` rows of
`row_type(channels)`. TOLD, about once a second and at the end: a JSON document, the report and the histograms so far;
`finished` is true in the last one of a run that came to its end. A reader stops at the first chunk that is not whole.
"""

from __future__ import annotations

import contextlib
import json
import os
import stat
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError

MAGIC = b"hapsim trace\r\n\x1a\n"
VERSION = 1
MOST_ROWS = 1 << 15
"""In a chunk: what a reader has in memory at once."""

_CHUNK = struct.Struct("<4sIII")
_HEAD, _ROWS, _TOLD = b"HEAD", b"ROWS", b"TOLD"
_MOST_BYTES = 1 << 26  # of a chunk; one that says it is longer is damaged


ROWS = ("sample", "time_ns", "flags", "position_counts", "force_counts", "asked_force")
"""The columns of a trace that have a row for each tick, by their names there."""


def row_type(channels: int) -> np.dtype[Any]:
    """A row as it is in the file: little-endian, without gaps."""
    each = (channels,)
    return np.dtype(
        [
            ("sample", "<i8"),
            ("time_ns", "<i8"),
            ("flags", "u1"),
            ("position_counts", "<i4", each),
            ("force_counts", "<i4", each),
            ("asked_force", "<f8", each),
        ]
    )


class Head(NamedTuple):
    """What holds for the whole file."""

    rate_hz: float
    position_scale: list[float]
    """m per count, by channel."""
    force_scale: list[float]
    """N per count, by channel."""
    scene: str = ""
    """Its file, where it has one."""
    begun: str = ""
    """UTC, ISO 8601."""

    @property
    def channels(self) -> int:
        return len(self.position_scale)


class StreamWriter:
    """Writes chunks, each in one go: a file that ends within one is cut there by whoever reads it."""

    def __init__(self, descriptor: int, head: Head, told: dict[str, Any]) -> None:
        """`descriptor`: of an empty file, which becomes this object's to close; `told`: before there are rows. OSError
        where nothing can be written."""
        self.written = 0
        """Rows so far."""
        self._descriptor = descriptor
        self._end = 0
        self._was_cut_short = False
        try:
            self._write(MAGIC)
            whole = {"version": VERSION, "channels": head.channels, **head._asdict(), "told": told}
            self._chunk(_HEAD, 0, _as_json(whole))
        except OSError:
            os.close(descriptor)
            raise

    def rows(self, rows: NDArray[Any]) -> None:
        """Rows of `row_type`. OSError where not all of them could be written: then none of this call's last chunk
        are."""
        for first in range(0, len(rows), MOST_ROWS):
            piece = rows[first : first + MOST_ROWS]
            self._chunk(_ROWS, len(piece), piece.tobytes())
            self.written += len(piece)

    def tell(self, told: dict[str, Any]) -> None:
        """The report and the histograms so far. OSError where it could not be written."""
        self._chunk(_TOLD, 0, _as_json(told))

    def keep(self) -> None:
        """Has the system put on the disk what was written. OSError where it cannot."""
        with contextlib.suppress(ValueError):
            os.fsync(self._descriptor)

    def what_became_of(self, path: Path) -> str:
        """What another program did to the file that was opened as `path`, as a participle; "" where it is there."""
        written = os.fstat(self._descriptor)
        try:
            there = path.stat()
        except OSError:
            return "was removed"
        if (there.st_dev, there.st_ino) != (written.st_dev, written.st_ino):
            return "was replaced"
        return "was cut short" if self._was_cut_short or self._is_too_short() else ""

    def _is_too_short(self) -> bool:
        written = os.fstat(self._descriptor)
        return stat.S_ISREG(written.st_mode) and written.st_size < self._end

    def close(self) -> None:
        os.close(self._descriptor)

    def _chunk(self, kind: bytes, count: int, payload: bytes) -> None:
        check = zlib.crc32(payload, zlib.crc32(kind + struct.pack("<II", count, len(payload))))
        self._write(_CHUNK.pack(kind, count, len(payload), check) + payload)

    def _write(self, data: bytes) -> None:
        """All of it, or else the file is as long as before. In one that another program cut short it leaves a hole."""
        self._was_cut_short = self._was_cut_short or self._is_too_short()
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
    """Reads such a file, from its beginning as often as wanted. UsageError where it is none."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as stream:
            if stream.read(len(MAGIC)) != MAGIC:
                raise UsageError(f"{path}: not a trace that hapsim wrote")
            kind, _, payload = _next_chunk(stream) or (b"", 0, b"")
            if kind != _HEAD:
                raise UsageError(f"{path}: the trace was cut off, or damaged, before its first row")
            self._begin = stream.tell()
        head = json.loads(payload)
        if head["version"] != VERSION:
            raise UsageError(
                f"{path}: found version {head['version']} of hapsim's stream of rows, expected {VERSION}: it takes a "
                "newer hapsim"
            )
        self.head = Head(**{name: head[name] for name in Head._fields})
        self.told: dict[str, Any] = head["told"]
        """The last that is known of the report and the histograms, once the rows were read."""
        self.is_finished = False
        """Whether it was the run's end, and nothing follows it."""
        self.unread_bytes = 0
        """Behind the last whole chunk: a torn end, or what is damaged and all that follows it."""
        self.damaged_at: int | None = None
        """The byte from which on it cannot be read, where that is not just a chunk of which the end is missing."""

    def rows(self) -> Iterator[NDArray[Any]]:
        """Its rows, chunk by chunk; then `told`, `is_finished`, `unread_bytes` and `damaged_at` are known."""
        told, good, kind = b"", self._begin, b""
        with self._path.open("rb") as stream:
            stream.seek(self._begin)
            while chunk := _next_chunk(stream):
                kind, count, payload = chunk
                if kind == _ROWS:
                    of = row_type(self.head.channels)
                    if len(payload) != count * of.itemsize:
                        break
                    yield np.frombuffer(payload, of)
                elif kind == _TOLD:
                    told = payload
                good = stream.tell()
            self.unread_bytes = os.fstat(stream.fileno()).st_size - good
            self.damaged_at = good if _is_damaged(stream, good, row_type(self.head.channels).itemsize) else None
        self.told = json.loads(told) if told else self.told
        self.is_finished = bool(self.told["finished"]) and kind == _TOLD and self.unread_bytes == 0

    def count(self) -> int:
        """How many rows there are."""
        return sum(len(rows) for rows in self.rows())


def is_stream(path: Path) -> bool:
    """Whether the file begins as one. OSError where it cannot be read."""
    with path.open("rb") as stream:
        return stream.read(len(MAGIC)) == MAGIC


def _next_chunk(stream: BinaryIO) -> tuple[bytes, int, bytes] | None:
    """(kind, count, payload); None where no whole one follows."""
    head = stream.read(_CHUNK.size)
    if len(head) < _CHUNK.size:
        return None
    kind, count, size, check = _CHUNK.unpack(head)
    if size > _MOST_BYTES:
        return None
    payload = stream.read(size)
    if len(payload) < size or zlib.crc32(payload, zlib.crc32(head[:12])) != check:
        return None
    return kind, count, payload


def _is_damaged(stream: BinaryIO, at: int, row_bytes: int) -> bool:
    """Whether what is there from byte `at` on is more than the beginning of a chunk, and yet none. A whole one was
    written meanwhile."""
    stream.seek(at)
    head = stream.read(_CHUNK.size)
    if len(head) < _CHUNK.size:
        return not any(kind.startswith(head[: len(kind)]) for kind in (_ROWS, _TOLD))
    kind, count, size, _ = _CHUNK.unpack(head)
    fits = size == count * row_bytes if kind == _ROWS else kind == _TOLD and count == 0
    if not fits or size > _MOST_BYTES:
        return True
    is_all_there = os.fstat(stream.fileno()).st_size >= at + _CHUNK.size + size
    stream.seek(at)
    return is_all_there and _next_chunk(stream) is None


def _as_json(value: dict[str, Any]) -> bytes:
    return json.dumps(value).encode()
