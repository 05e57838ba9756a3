"""A file that a thread of its own writes while a run goes on, so that nothing waits for the disk.

A disk that is slow for a while costs memory, up to a bound; a full one costs the rest of the file, but no force.
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

_WRITE_S = 0.25  # how often what has gathered is written: a process that is killed loses no more
_SUMMARY_S = 1.0  # how often what the file says of itself is written, and the system puts all of it on the disk
_MOST_BYTES = 1 << 26  # that wait to be written
_PATIENCE_S = 5.0  # in virtual time, where no hand has to wait for the disk
_POLL_S = 0.01


class BackgroundFile:
    """The thread and what waits for it. A subclass opens `path`, begins with `_start`, and says how to write."""

    def __init__(self, path: Path, on_warning: Callable[[str], None], what: str, unit: str) -> None:
        """`on_warning` is called if the disk fails, in the writing thread. `what`, `unit`: words for the file and for
        one of its rows."""
        self._path = self._part = path
        self._on_warning, self._what, self._unit = on_warning, what, unit
        self.failure = ""
        """Why rows are missing, or the file that was asked for; "" where nothing is."""
        self._is_broken = False
        self._taken = 0
        self._notes: deque[dict[str, Any]] = deque()
        self._waiting: SimpleQueue[NDArray[Any]] = SimpleQueue()
        self._put_bytes = self._done_bytes = 0
        self._ends = threading.Event()
        self._thread = threading.Thread(target=self._write_all, name=what, daemon=True)

    def take_notes(self, notes: Iterable[dict[str, Any]]) -> None:
        """Takes what happened beside the rows that are put next."""
        self._notes.extend(notes)

    def _start(self) -> None:
        self._thread.start()

    @abstractmethod
    def _write(self, rows: NDArray[Any]) -> None:
        """Writes rows. OSError where not all could be written."""

    def _write_note(self, note: dict[str, Any]) -> None:
        """Writes a note, where the file has any. OSError where it cannot."""

    @abstractmethod
    def _summarize(self) -> None:
        """Writes what the file says of itself, once a second."""

    @property
    @abstractmethod
    def written(self) -> int:
        """Rows in the file."""

    def put(self, rows: NDArray[Any], patient: bool = False) -> None:
        """Takes rows to be written. `patient`: waits for the disk if too many wait already."""
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
        """How the file, once it is finished, is not as it was asked for, as a sentence; "" where it is."""
        if not self.failure:
            return ""
        missing = f"{self.unwritten} {self._unit}s are" if self.unwritten else f"no {self._unit} is"
        place = next((one for one in (self._part, self._path) if one.exists()), None)
        kept = f"{missing} missing, what was written is in {place}" if place else f"{self._path} does not exist"
        return f"the {self._what} is not what was asked for ({self.failure}): {kept}"

    @property
    def unwritten(self) -> int:
        """Rows that were put and are not in the file."""
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
            except Exception as error:  # of the disk; or a defect, which must not end in rows without end in memory
                self._is_broken = True
                self._warn(in_words(error))
            self._done_bytes += sum(rows.nbytes for rows in waiting)


def lock(descriptor: int, path: Path, what: str) -> None:
    """Locks the file until the descriptor is closed. UsageError where another run has; a system or a file system
    without locks gives none."""
    try:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise UsageError(f"{path}: another run writes its {what} there: name another file") from error
    except (ImportError, OSError):
        return


def require_writable(path: Path) -> None:
    """UsageError where no file could be written there: better before the run than after it."""
    directory = path.resolve().parent
    if not directory.is_dir():
        raise UsageError(f"{path}: there is no directory {directory}")
    is_other = path.exists() and not path.is_file() and not path.is_char_device()  # opening a pipe would wait
    if is_other or not os.access(path if path.exists() else directory, os.W_OK):
        raise UsageError(f"{path}: no file can be written there")


def in_words(error: Exception) -> str:
    """Returns why a file could not be written."""
    return (isinstance(error, OSError) and error.strerror) or str(error) or type(error).__name__
