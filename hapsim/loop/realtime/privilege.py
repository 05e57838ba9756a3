"""What came of asking the system for something, and how asking becomes a measure that is undone."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass

ONLY_LINUX = "only Linux has it"


@dataclass(frozen=True)
class PrivilegeResult:
    """One measure as the system answered it."""

    privilege: str
    """What people call it: ``SCHED_FIFO``."""
    granted: bool
    detail: str
    """Got: what exactly (``priority 80``). Denied: why, and what to do about it, without a full stop."""


Measure = Callable[[int], AbstractContextManager[PrivilegeResult]]
"""Asks for something for the process and its thread with this native id, and gives it back on leaving."""

Ask = Callable[[int], tuple[str, Callable[[], object]]]
"""The asking alone: returns what exactly was granted and what undoes it, or raises OSError."""


def measure(name: str, advise: Callable[[OSError], str], *, everywhere: bool = False) -> Callable[[Ask], Measure]:
    """Makes a measure called `name` of a function that asks. `advise`: the sentence about an error that the call met.
    `everywhere`: not only on Linux.

    The measure raises for no error of the system, neither in asking nor in undoing.
    """

    def _make(ask: Ask) -> Measure:
        @contextlib.contextmanager
        def _held(thread_id: int) -> Iterator[PrivilegeResult]:
            if sys.platform != "linux" and not everywhere:
                answer, undo = PrivilegeResult(name, False, ONLY_LINUX), _nothing
            else:
                answer, undo = _asked(name, ask, advise, thread_id)
            try:
                yield answer
            finally:
                # The body's own failure matters more than anything that could not be given back.
                with contextlib.suppress(Exception):
                    undo()

        return _held

    return _make


def denied(name: str, error: OSError, advise: Callable[[OSError], str]) -> PrivilegeResult:
    """The refusal of `name` in words: `advise` has to know only the errors that are the measure's own."""
    if error.errno == errno.ESRCH:
        return PrivilegeResult(name, False, "the loop's thread is not there: it has ended already")
    if error.errno == errno.ENOSYS:
        return PrivilegeResult(name, False, "this kernel or C library does not have the call; another one may")
    try:
        return PrivilegeResult(name, False, advise(error))
    except Exception:  # what to do about it is asked of the system, too
        return PrivilegeResult(name, False, f"it was refused ({error.strerror or error})")


def _asked(
    name: str, ask: Ask, advise: Callable[[OSError], str], thread_id: int
) -> tuple[PrivilegeResult, Callable[[], object]]:
    try:
        detail, undo = ask(thread_id)
    except OSError as error:
        return denied(name, error, advise), _nothing
    except AttributeError as missing:
        return PrivilegeResult(name, False, f"this Python was built without the call ({missing})"), _nothing
    except Exception as error:  # an answer that no system should give is no reason to end a run
        why = f"the system's answer could not be used ({type(error).__name__}: {error})"
        return PrivilegeResult(name, False, why), _nothing
    return PrivilegeResult(name, True, detail), undo


def _nothing() -> None:
    """There is nothing to be undone."""
