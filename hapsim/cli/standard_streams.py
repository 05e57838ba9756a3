"""Standard output and error of a program that may outlive whoever reads them: a terminal, a pipe, a log."""

from __future__ import annotations

import contextlib
import errno
import os
import select
import sys
from collections.abc import Iterator
from typing import Any

_PATIENCE_S = 1.0  # with a reader that is slow, each time
_GONE = (errno.EIO, errno.EPIPE, errno.ENXIO, errno.EBADF)


@contextlib.contextmanager
def standing_streams() -> Iterator[None]:
    """While open, standard error takes everything and raises nothing: what nobody reads is no reason to end a run.
    Standard output raises BrokenPipeError however its reader went, and so says that it was the output that failed."""
    _hold_descriptors()
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _Output(_opened(sys.stdout, 1)), _Messages(_opened(sys.stderr, 2))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _hold_descriptors() -> None:
    """Where a standard descriptor was closed, the next file that is opened would get its number: a serial port as
    standard error would be written to by whoever complains."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest number that is free: this one


def _opened(stream: Any, number: int) -> Any:
    """The stream; of a program that was started without, one on the descriptor that stands in its place."""
    return open(number, "w", encoding="utf-8", closefd=False) if stream is None else stream


class _Stream:
    """Another one, for everything but what is said here."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def _failed(self, error: OSError) -> None:
        raise NotImplementedError

    def write(self, text: str) -> int:
        try:
            return int(self._stream.write(text))
        except OSError as error:
            self._failed(error)
            return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        try:
            self._stream.flush()
        except OSError as error:
            self._failed(error)


class _Messages(_Stream):
    def write(self, text: str) -> int:
        return super().write(text) if self._is_taken() else len(text)

    def flush(self) -> None:
        if self._is_taken():
            super().flush()

    def _is_taken(self) -> bool:
        """Whether who reads it takes some more, a pipe that is full or a terminal that was halted (Ctrl-S) does not:
        there a run that shall stop would never come to its end."""
        try:
            return bool(select.select([], [self._stream.fileno()], [], _PATIENCE_S)[1])
        except (OSError, ValueError):  # it is no file, or cannot be waited for
            return True

    def _failed(self, error: OSError) -> None:
        """Nobody is left to be told."""


class _Output(_Stream):
    def _failed(self, error: OSError) -> None:
        if error.errno in _GONE and not isinstance(error, BrokenPipeError):
            raise BrokenPipeError(errno.EPIPE, os.strerror(errno.EPIPE)) from error
        raise error
