"""A measure: a privilege that is requested from the system, reported as granted or denied, and given back."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
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
    """Granted: what exactly (``priority 80``). Denied: why, and what to do about it, without a full stop."""


Measure = Callable[[int], AbstractContextManager[PrivilegeResult]]
"""Requests something for the process and its thread with this native id, and gives it back on leaving."""

Request = Callable[[int], tuple[str, Callable[[], object]]]
"""The request alone: returns what exactly was granted and what undoes it, or raises OSError."""


def measure(name: str, advise: Callable[[OSError], str], *, everywhere: bool = False) -> Callable[[Request], Measure]:
    """Makes a measure called `name` of a function that requests. `advise`: the sentence about an error of the call.
    `everywhere`: not only on Linux.

    The measure raises for no error of the system, neither in requesting nor in undoing.
    """

    def _make(request: Request) -> Measure:
        @contextlib.contextmanager
        def _held(thread_id: int) -> Iterator[PrivilegeResult]:
            undo: Callable[[], object] = lambda: None  # noqa: E731
            try:
                if sys.platform == "linux" or everywhere:
                    detail, undo = request(thread_id)
                    answer = PrivilegeResult(name, True, detail)
                else:
                    answer = PrivilegeResult(name, False, ONLY_LINUX)
            except OSError as error:
                answer = denied(name, error, advise)
            except Exception as error:  # an answer that no system should give is no reason to end a run
                why = f"the system's answer could not be used ({type(error).__name__}: {error})"
                answer = PrivilegeResult(name, False, why)
            try:
                yield answer
            finally:
                # The body's own failure matters more than anything that could not be given back.
                with contextlib.suppress(Exception):
                    undo()

        return _held

    return _make


def denied(name: str, error: OSError, advise: Callable[[OSError], str]) -> PrivilegeResult:
    """The refusal of `name` in words. `advise` has to know only the errors that are the measure's own."""
    if error.errno == errno.ESRCH:
        return PrivilegeResult(name, False, "the loop's thread is not there: it has ended already")
    if error.errno == errno.ENOSYS:
        return PrivilegeResult(name, False, "this kernel or C library does not have the call; another one may")
    try:
        return PrivilegeResult(name, False, advise(error))
    except Exception:  # what to do about it is asked of the system, too
        return PrivilegeResult(name, False, f"it was refused ({error.strerror or error})")


def call_c(name: str, *arguments: int) -> int:
    """The result of the C library's function `name`, which Python's standard library does not offer. Raises OSError
    with its errno where that is -1, with ENOSYS where there is no such function."""
    library = ctypes.CDLL(None, use_errno=True)
    function = getattr(library, name, None)
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS), name)
    # prctl takes any number of arguments and reads each of them as an unsigned long.
    result = int(function(*map(ctypes.c_ulong, arguments)))
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), name)
    return result


def is_root() -> bool:
    """Whether the user is root already. Decides what is advised, never what is tried."""
    return os.geteuid() == 0


def login_limit(item: str, value: str) -> str:
    """What raises this user's limit on `item`, as in limits.conf(5), to be said after "it takes"."""
    return f"the line '{_user()} - {item} {value}' in /etc/security/limits.d/hapsim.conf and a new login"


def _user() -> str:
    import pwd

    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user of a container need not be in its list
        return "*"
