"""The reader of the loop's ring: rows are kept for a trace in memory, or written to a file meanwhile.

A thread of its own writes the file, and nothing waits for it: neither the loop nor the thread that empties its ring. A
disk that is slow for a while costs memory, up to a bound; a full one costs the rest of the record, but no force.
"""

from __future__ import annotations

import contextlib
import itertools
import os
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.loop.ring import Ring
from hapsim.recording.report import Report, Statistics, summary_document
from hapsim.recording.stream import Head, StreamWriter
from hapsim.recording.trace import convert

_WRITE_S = 0.25  # how often what has gathered is written: a process that is killed loses no more
_SUMMARY_S = 1.0  # how often the report so far is written, and the system puts all of it on the disk
_MOST_BYTES = 1 << 26  # that wait to be written
_PATIENCE_S = 5.0  # in virtual time, where no hand has to wait for the disk
_POLL_S = 0.01


class Recorder:
    """The ring's reader. `keep`: False frees the rows without keeping them, but for the last `recent` ones or a few
    more."""

    def __init__(self, ring: Ring, keep: bool, recent: int = 1) -> None:
        self._ring, self._keep, self._recent = ring, keep, recent
        self._lock = threading.Lock()
        self._kept: list[NDArray[Any]] = []
        self._last = deque([ring.drain()])
        self.file: RecordFile | None = None
        """The file that is written meanwhile, if any."""

    def collect(self) -> None:
        """Empties the ring; from any thread."""
        with self._lock:
            rows = self._ring.drain()
            if not rows.size:
                return
            if self._keep:
                self._kept.append(rows)
            self._last.append(rows)
            while sum(one.size for one in self._last) - self._last[0].size >= self._recent:
                self._last.popleft()
            if self.file is not None:
                self.file.put(rows, patient=bool(self._ring.record.waits))

    def rows(self) -> NDArray[Any]:
        """Everything kept."""
        return np.concatenate([self._last[0][:0], *self._kept])

    def last_rows(self) -> NDArray[Any]:
        """The `recent` rows that came last."""
        return np.concatenate(self._last)[-self._recent :]


class RecordFile:
    """A record that is being written. `path`: .trace, which is a stream itself; or .npz or .csv, beside which the
    stream is FILE.part until the run has ended."""

    def __init__(
        self,
        path: Path,
        head: Head,
        report_so_far: Callable[[], tuple[Report, Statistics]],
        on_warning: Callable[[str], None],
    ) -> None:
        """`on_warning` is called if the disk fails, in the writing thread. UsageError where no file can be begun."""
        self._path, self._on_warning = path, on_warning
        self._summary = lambda: summary_document(*report_so_far(), False)
        self._failure = ""  # why rows are missing, or the file that was asked for
        self._is_broken = False
        self._taken = 0
        try:
            self._part, descriptor = _open_free(path)
            self._writer = StreamWriter(descriptor, head, self._summary())
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {_in_words(error)}") from error
        self._waiting: SimpleQueue[NDArray[Any]] = SimpleQueue()
        self._put_bytes = self._done_bytes = 0
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name="record", daemon=True)
        self._thread.start()

    def put(self, rows: NDArray[Any], patient: bool = False) -> None:
        """Takes rows to be written. `patient`: waits for the disk if too many wait already."""
        self._taken += rows.size
        deadline = time.monotonic() + (_PATIENCE_S if patient else 0.0)
        while self._is_behind and time.monotonic() < deadline:
            time.sleep(_POLL_S)
        if self._is_behind:
            self._warn("the disk is slower than the run")
        elif not self._is_broken:
            self._put_bytes += rows.nbytes
            self._waiting.put(rows)

    @property
    def _is_behind(self) -> bool:
        return self._put_bytes - self._done_bytes >= _MOST_BYTES

    def finish(self, report: Report, statistics: Statistics) -> Report:
        """The run is over: writes what waits, the report and the histograms, and the file that was asked for. Returns
        the report, with the count of rows that were not written."""
        self._ends.set()
        self._thread.join()
        report = replace(report, unrecorded_rows=self._unrecorded)
        try:
            self._writer.write_summary(summary_document(report, statistics, True))
            if self._part != self._path:  # under its own name the file is whole, or the older file stays
                whole = self._part.with_name(f"{self._part.name}.whole")
                try:
                    convert(self._part, whole, self._path.suffix)
                    os.replace(whole, self._path)
                finally:
                    whole.unlink(missing_ok=True)
                self._part.unlink()
        except Exception as error:  # of the disk, or of a damaged stream
            self._failure = self._failure or _in_words(error)
        self._writer.close()
        return report

    @property
    def problem(self) -> str:
        """How the record, once it is finished, is not as it was asked for, as a sentence; "" where it is."""
        if not self._failure:
            return ""
        missing = f"{self._unrecorded} rows are missing" if self._unrecorded else "no row is missing"
        place = self._part if self._part.exists() else self._path
        return f"the record is not what was asked for ({self._failure}): {missing}, what was written is in {place}"

    @property
    def _unrecorded(self) -> int:
        return self._taken - self._writer.written

    def _warn(self, why: str) -> None:
        """Reports that rows are missing, the first time."""
        if not self._failure:
            self._failure = why
            with contextlib.suppress(Exception):  # a failure to show the warning does not end the record
                self._on_warning(
                    f"{self._part}: from here on rows are missing from the record ({why}). The run goes on; what was "
                    "written stays"
                )

    def _write_all(self) -> None:
        last_summary, ends = time.monotonic(), False
        while not ends:
            ends = self._ends.wait(_WRITE_S)
            waiting = [self._waiting.get() for _ in range(self._waiting.qsize())]
            try:
                if waiting and not self._is_broken:
                    self._writer.write_rows(np.concatenate(waiting))
                if time.monotonic() - last_summary >= _SUMMARY_S and not self._is_broken:
                    self._writer.write_summary(self._summary())
                    last_summary = time.monotonic()
            except Exception as error:  # of the disk; or a defect, which must not end in rows without end in memory
                self._is_broken = True
                self._warn(_in_words(error))
            self._done_bytes += sum(rows.nbytes for rows in waiting)


def _open_free(path: Path) -> tuple[Path, int]:
    """The file of the stream and its descriptor, empty and locked for this run. A part that a run left when it died
    stays: the next is FILE.part2. UsageError where another run writes there."""
    parts = (path.with_name(f"{path.name}.part{number if number > 1 else ''}") for number in itertools.count(1))
    for part in itertools.repeat(path) if path.suffix == ".trace" else parts:
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0), 0o666)
        try:
            _lock(descriptor, part)
            if part == path and os.fstat(descriptor).st_size:
                os.ftruncate(descriptor, 0)
            if os.fstat(descriptor).st_size == 0:
                return part, descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    raise AssertionError


def _lock(descriptor: int, path: Path) -> None:
    """Locks the file until the descriptor is closed. UsageError where another run has; a system or a file system
    without locks gives none."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(f"{path}: another run writes its record there: name another file") from error
    except (ImportError, OSError):
        return


def _in_words(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
