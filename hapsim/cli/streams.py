"""Standard output and error of a command: a closed terminal or pipe does not end a run."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import sys
from collections.abc import Callable, Iterator
from typing import Any

_GONE = (errno.EIO, errno.EPIPE, errno.ENXIO, errno.EBADF)


class _Stream:
    """A stream whose writes never fail. Once one would have, the rest goes to /dev/null."""

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.failure: OSError | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        self._try(lambda: self._stream.write(text))
        return len(text)

    def writelines(self, lines: Any) -> None:
        for line in lines:
            self.write(line)

    def flush(self) -> None:
        self._try(self._stream.flush)

    def _try(self, call: Callable[[], object]) -> None:
        try:
            call()
        except OSError as error:
            self.failure = self.failure or error
            with contextlib.suppress(OSError, ValueError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())


@contextlib.contextmanager
def resilient_streams() -> Iterator[None]:
    """Makes standard output and standard error raise no errors in the with-block; `output_failure` returns them."""
    _hold_descriptors()
    if sys.stdin is None:
        sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = (_Stream(_opened(stream, number)) for number, stream in enumerate(before, start=1))
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def output_ended() -> bool:
    """Returns whether standard output has lost its reader, or cannot be written."""
    return isinstance(sys.stdout, _Stream) and sys.stdout.failure is not None


def output_failure() -> OSError | None:
    """Flushes both streams. Returns the error of standard output; None if only its reader went away."""
    sys.stderr.flush()
    sys.stdout.flush()
    failure = sys.stdout.failure if isinstance(sys.stdout, _Stream) else None
    return None if failure is None or failure.errno in _GONE else failure


def _hold_descriptors() -> None:
    """Opens /dev/null on each standard descriptor that is closed. The next file would get its number: messages would
    go to a serial port that was opened as standard error."""
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # gets the lowest free number, which is this one


def _opened(stream: Any, number: int) -> Any:
    """Returns the stream; one on its descriptor if the program was started without."""
    if stream is None:
        return open(number, "w", encoding="utf-8", closefd=False)
    if isinstance(stream, io.TextIOWrapper):
        stream.reconfigure(errors="replace")  # a terminal that cannot show a character shows another
        if sys.platform == "win32" and "PYTHONIOENCODING" not in os.environ:
            stream.reconfigure(encoding="utf-8")  # Windows' code page for files and pipes lacks ┃ and ←
    return stream
