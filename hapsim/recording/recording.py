"""Writes a run's rows to a file while it runs, in a thread that nobody waits for: neither the loop nor whoever empties
its ring. A disk that is slow for a while costs memory, up to a bound; one that is full costs the rest of the record,
and nothing of the force.
"""

from __future__ import annotations

import contextlib
import errno
import os
import stat
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.recording.report import Report, Statistics, as_told
from hapsim.recording.stream import Head, StreamWriter
from hapsim.recording.streamed_trace import convert

_WRITE_S = 0.25  # how often what has gathered is written: a process that is killed loses no more
_KEEP_S = 1.0  # how often the system puts it on the disk, and the report so far is written
_MOST_BYTES = 1 << 26  # that wait to be written
_PATIENCE_S = 5.0  # in virtual time, where waiting for the disk holds up nobody's hand
_AT_ONCE_BYTES = 1 << 22  # so many are written before their time
_MOST_PARTS = 1000
_FOR_READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0)
_FOR_WRITING = os.O_WRONLY | os.O_CREAT | getattr(os, "O_BINARY", 0)

Tell = Callable[[], tuple[Report, Statistics]]


class Recording:
    """A record that is being written. `path`: .trace, which is a stream itself; or .npz or .csv, beside which the
    stream is FILE.part until the run has ended."""

    def __init__(self, path: Path, head: Head, tell: Tell, on_warning: Callable[[str], None]) -> None:
        """`tell`: the report and the histograms so far; `on_warning` hears of a disk that fails, in that thread.
        UsageError where no file can be begun."""
        self.path = path
        self._tell, self._on_warning = tell, on_warning
        self._failure = ""  # why rows are missing, or the file that was asked for
        self._lost = ""  # what another program did to the file
        self._is_broken = False
        self._handed = 0
        try:
            self._part, descriptor = self._begin()
            self._writer = StreamWriter(descriptor, head, as_told(*tell(), False))
        except OSError as error:
            raise UsageError(f"{path}: the trace cannot be written: {_in_words(error)}") from error
        self._waiting: list[NDArray[Any]] = []
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._ends = False
        self._thread = threading.Thread(target=self._write_all, name="record", daemon=True)
        self._thread.start()

    def put(self, rows: NDArray[Any], patient: bool = False) -> None:
        """Hands rows over to be written. `patient`: waits for the disk where too many wait already."""
        with self._changed:
            if patient:
                self._changed.wait_for(lambda: self._waiting_bytes < _MOST_BYTES, _PATIENCE_S)
            self._handed += rows.size
            if self._is_broken:
                return
            if self._waiting_bytes >= _MOST_BYTES:
                self._say("the disk is slower than the run")
                return
            self._waiting.append(rows)
            self._waiting_bytes += rows.nbytes
            if self._waiting_bytes > _AT_ONCE_BYTES:
                self._changed.notify_all()

    def finish(self, report: Report, statistics: Statistics) -> Report:
        """The run is over: writes what waits, the report and the histograms, and the file that was asked for. The
        report, with the rows that were not written."""
        with self._changed:
            self._ends = True
            self._changed.notify_all()
        self._thread.join()
        report = replace(report, unrecorded_rows=self._unrecorded)
        try:
            self._writer.tell(as_told(report, statistics, True))
            self._writer.keep()
        except OSError as error:
            self._failure = self._failure or _in_words(error)
        self._lost = self._writer.what_became_of(self._part)
        self._writer.close()
        if self._part != self.path and not self._lost:
            self._convert()
        return report

    @property
    def sentence(self) -> str:
        """What became of the record, once it is finished, where it is not as it was asked for; "" where it is."""
        if self._lost:
            return f"the record is lost: {self._part} {self._lost} by another program while the run went on"
        if not self._failure:
            return ""
        missing = f"{self._unrecorded} rows are missing" if self._unrecorded else "no row is missing"
        return (
            f"the record is not what was asked for ({self._failure}): {missing}, what was written is in {self._place}"
        )

    def _begin(self) -> tuple[Path, int]:
        """The stream's file, which takes no other's place where it is one beside the record."""
        if self.path.suffix == ".trace":
            return self.path, _open_empty(self.path)
        for number in range(1, _MOST_PARTS):
            part = self.path.with_name(f"{self.path.name}.part{number if number > 1 else ''}")
            try:
                descriptor = os.open(part, _FOR_WRITING | os.O_EXCL, 0o666)
            except FileExistsError:
                _require_unlocked(part)
                continue
            _lock(descriptor, part)
            if number > 1:
                self._on_warning(
                    f"{self.path}.part: the record of a run that has not come to its end; it stays (hapsim.load_trace "
                    "reads it, and so far as it goes it is whole)"
                )
            return part, descriptor
        raise FileExistsError(errno.EEXIST, f"{_MOST_PARTS} unfinished records are beside it")

    def _convert(self) -> None:
        before = _identity(self.path)
        try:
            convert(self._part, self.path)
        except Exception as error:  # of the disk; or of what another program made of the stream
            self._failure = self._failure or _in_words(error)
            if self.path.is_file() and _identity(self.path) != before:  # an older record that was not touched stays
                with contextlib.suppress(OSError):
                    self.path.unlink()
            return
        with contextlib.suppress(OSError):
            self._part.unlink()

    @property
    def _place(self) -> Path:
        return self._part if self._part.exists() else self.path

    @property
    def _unrecorded(self) -> int:
        return self._handed - self._writer.written

    def _say(self, why: str) -> None:
        """Says that rows are missing, the first time."""
        if not self._failure:
            self._failure = why
            with contextlib.suppress(Exception):  # whoever hears it: the record does not end of that
                self._on_warning(
                    f"{self._part}: from here on rows are missing from the record ({why}). The run goes on; what was "
                    "written stays"
                )

    def _write_all(self) -> None:
        told = time.monotonic()
        ends = False
        while not ends:
            with self._changed:
                self._changed.wait_for(lambda: self._ends or self._waiting_bytes > _AT_ONCE_BYTES, _WRITE_S)
                waiting, self._waiting, ends = self._waiting, [], self._ends
            try:
                if waiting and not self._is_broken:
                    self._writer.rows(np.concatenate(waiting))
                if time.monotonic() - told >= _KEEP_S and not self._is_broken:
                    self._writer.tell(as_told(*self._tell(), False))
                    self._writer.keep()
                    told = time.monotonic()
            except Exception as error:  # of the disk; or a defect, which must not end in rows without end in memory
                self._is_broken = True
                self._say(_in_words(error))
            with self._changed:
                self._waiting_bytes = sum(rows.nbytes for rows in self._waiting)
                self._changed.notify_all()


def _open_empty(path: Path) -> int:
    """Nothing of what is in it is lost before it is known to be nobody's."""
    descriptor = os.open(path, _FOR_WRITING, 0o666)
    try:
        if stat.S_ISREG(os.fstat(descriptor).st_mode):
            _lock(descriptor, path)
            os.ftruncate(descriptor, 0)
    except BaseException:
        os.close(descriptor)
        raise
    return descriptor


def _require_unlocked(path: Path) -> None:
    """UsageError where a run writes to it."""
    try:
        descriptor = os.open(path, _FOR_READING)
    except OSError:
        return
    try:
        _lock(descriptor, path)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path) -> None:
    """Has the kernel know that this run writes there, until the descriptor is closed. UsageError where another does; a
    file system that knows no locks gives none."""
    try:
        import fcntl
    except ImportError:  # not a Unix
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(f"{path}: another run writes its record there: name another file") from error
    except OSError:
        return


def _identity(path: Path) -> tuple[int, ...]:
    """What changes when a file is written to; () where there is none."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ino, found.st_size, found.st_mtime_ns


def _in_words(error: Exception) -> str:
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
