"""A file written by its own thread during a run, so that the run never waits for the disk.

While the disk is slow, rows wait in memory, up to a limit. A full disk loses the rest of the file, but no force.
"""

from __future__ import annotations

import contextlib
import os
import threading
import time
from abc import abstractmethod
from collections import deque
from collections.abc import Callable, Iterable
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError

_WRITE_S = 0.25  # interval between writes: a killed process loses no more
_SUMMARY_S = 1.0  # interval between summaries, which also flush the file to the disk
_MOST_BYTES = 1 << 26  # largest backlog
_PATIENCE_S = 5.0  # in virtual time, where no hand has to wait for the disk
_POLL_S = 0.01


class BackgroundFile:
    """The writing thread and its backlog. A subclass opens `path`, calls `_start`, and implements the writing."""

    def __init__(self, path: Path, on_warning: Callable[[str], None], what: str, unit: str) -> None:
        """The writing thread calls `on_warning` if the disk fails. `what`, `unit`: words for the file and for a row."""
        self._path = self._part = path
        self._on_warning, self._what, self._unit = on_warning, what, unit
        self.failure = ""
        """The reason if rows or the requested file are missing, else ""."""
        self._is_broken = False
        self._taken = 0
        self._notes: deque[dict[str, Any]] = deque()
        self._waiting: SimpleQueue[NDArray[Any]] = SimpleQueue()
        self._put_bytes = self._done_bytes = 0
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name=what, daemon=True)

    def take_notes(self, notes: Iterable[dict[str, Any]]) -> None:
        """Queues notes about the rows that are put next."""
        self._notes.extend(notes)

    def _start(self) -> None:
        self._thread.start()

    @abstractmethod
    def _write(self, rows: NDArray[Any]) -> None:
        """Writes rows. Raises OSError if not all could be written."""

    def _write_note(self, note: dict[str, Any]) -> None:
        """Writes a note, if the file has notes. Raises OSError if it cannot."""

    @abstractmethod
    def _summarize(self) -> None:
        """Writes the file's summary, once a second."""

    @property
    @abstractmethod
    def written(self) -> int:
        """Number of rows in the file."""

    def put(self, rows: NDArray[Any], patient: bool = False) -> None:
        """Queues rows for writing. `patient`: waits for the disk if the backlog is full."""
        self._taken += len(rows)
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

    def _join(self) -> None:
        """Waits until everything is written."""
        self._ends.set()
        self._thread.join()

    @property
    def problem(self) -> str:
        """A sentence about a finished file that is incomplete or missing; "" if it is complete."""
        if not self.failure:
            return ""
        missing = f"{self.unwritten} {self._unit}s are" if self.unwritten else f"no {self._unit} is"
        place = next((one for one in (self._part, self._path) if one.exists()), None)
        kept = f"{missing} missing, what was written is in {place}" if place else f"{self._path} does not exist"
        return f"the {self._what} is not what was asked for ({self.failure}): {kept}"

    @property
    def unwritten(self) -> int:
        """Number of rows that were put and are not in the file."""
        return self._taken - self.written

    def _warn(self, why: str) -> None:
        """Reports that rows are missing, the first time."""
        if not self.failure:
            self.failure = why
            with contextlib.suppress(Exception):  # a failure to show the warning does not end the file
                self._on_warning(
                    f"{self._part}: from here on {self._unit}s are missing from the {self._what} ({why}). The run goes "
                    "on; what was written stays"
                )

    def _write_all(self) -> None:
        last_summary, ends = time.monotonic(), False
        while not ends:
            ends = self._ends.wait(_WRITE_S)
            waiting = [self._waiting.get() for _ in range(self._waiting.qsize())]
            try:
                while self._notes and not self._is_broken:
                    self._write_note(self._notes.popleft())
                if waiting and not self._is_broken:
                    self._write(np.concatenate(waiting))
                if time.monotonic() - last_summary >= _SUMMARY_S and not self._is_broken:
                    self._summarize()
                    last_summary = time.monotonic()
            except Exception as error:  # the disk, or a defect: rows must not pile up in memory
                self._is_broken = True
                self._warn(in_words(error))
            self._done_bytes += sum(rows.nbytes for rows in waiting)


def lock(descriptor: int, path: Path, what: str) -> None:
    """Locks the file until the descriptor is closed. Raises UsageError if another run has locked it. Does nothing on a
    system or file system without locks."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(f"{path}: another run writes its {what} there: name another file") from error
    except (ImportError, OSError):
        return


def require_writable(path: Path, *endings: str) -> None:
    """Raises UsageError if no file with one of these endings [default: any] can be written to `path`. Call it before
    the run."""
    if endings and path.suffix not in endings:
        raise UsageError(f"{path}: found the ending '{path.suffix}', expected {', '.join(endings)}")
    directory = path.resolve().parent
    if not directory.is_dir():
        raise UsageError(f"{path}: there is no directory {directory}")
    is_other = path.exists() and not path.is_file() and not path.is_char_device()  # opening a pipe would wait
    if is_other or not os.access(path if path.exists() else directory, os.W_OK):
        raise UsageError(f"{path}: no file can be written there")


def in_words(error: Exception) -> str:
    """Returns why a file could not be written."""
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
