"""What becomes of a command whose output cannot be written: nobody reads it any more, or the disk is full."""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator

from hapsim.errors import HapsimError, UsageError


@contextlib.contextmanager
def guarded_output() -> Iterator[None]:
    """Whoever reads our output may have seen enough, as `head` has after a line: that is no failure, nothing is said
    of it, and what ended the command otherwise stays its status. A full disk is a sentence and a status.

    Not by the signal that ends other programs here (SIGPIPE): a run has to release its force first.
    """
    try:
        yield
    except BrokenPipeError as closed:  # while something else was being told
        status = _status_of(closed.__context__)
    except OSError as error:
        if not is_full(error):
            raise
        status = _complain(error)
    except SystemExit as ending:
        # typer and rich make a status 1 of it, which would be a defect of ours.
        status = 0 if isinstance(ending.__context__, BrokenPipeError) and ending.code == 1 else ending.code
    else:
        status = 0
    sys.exit(_flushed(status))


def is_full(error: BaseException) -> bool:
    """Whether it says that there is no room to write."""
    return isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)


def _complain(error: OSError) -> int:
    print(f"hapsim: the output cannot be written: {error.strerror}", file=sys.stderr)
    return UsageError.exit_status


def _status_of(told: BaseException | None) -> int | str | None:
    if isinstance(told, SystemExit):
        return told.code
    if isinstance(told, HapsimError):
        return told.exit_status
    return 0 if told is None else 1


def _flushed(status: int | str | None) -> int | str | None:
    """The status, or that of an output that could not be written. What is left in the buffers goes out here: at its
    very end Python would complain of it by itself."""
    for stream in (sys.stdout, sys.stderr):
        if stream is None:  # it was closed before we began
            continue
        try:
            stream.flush()
        except OSError as error:
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
            if is_full(error):
                status = _complain(error)
    return status
