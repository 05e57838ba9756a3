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
    """The system's answer to one measure."""

    privilege: str
    """Its usual name: ``SCHED_FIFO``."""
    granted: bool
    detail: str
    """Granted: what exactly (``priority 80``). Denied: why, and what to do about it, without a full stop."""


Measure = Callable[[int], AbstractContextManager[PrivilegeResult]]
"""Requests something for the process and its thread with this native id, and gives it back on leaving."""

Request = Callable[[int], Iterator[str]]
"""A generator that requests, yields what exactly was granted, and then undoes it; or raises OSError at first."""


def measure(name: str, advise: Callable[[OSError], str], *, everywhere: bool = False) -> Callable[[Request], Measure]:
    """Makes a measure called `name` of a request. `advise` returns the sentence about an error of the call.
    `everywhere`: not only on Linux.

    The measure raises no error of the system, neither in requesting nor in undoing.
    """

    def _make(request: Request) -> Measure:
        @contextlib.contextmanager
        def _held(thread_id: int) -> Iterator[PrivilegeResult]:
            asked = request(thread_id)
            try:
                if sys.platform == "linux" or everywhere:
                    answer = PrivilegeResult(name, True, next(asked))
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
                # The body's own failure matters more than what could not be given back.
                with contextlib.suppress(Exception):
                    if answer.granted:
                        next(asked, None)

        return _held

    return _make


def denied(name: str, error: OSError, advise: Callable[[OSError], str]) -> PrivilegeResult:
    """Returns the denial of `name`. `advise` has to know only the errors that are the measure's own."""
    if error.errno == errno.ESRCH:
        return PrivilegeResult(name, False, "the loop's thread is not there: it has ended already")
    if error.errno == errno.ENOSYS:
        return PrivilegeResult(name, False, "this kernel or C library does not have the call; another one may")
    try:
        return PrivilegeResult(name, False, advise(error))
    except Exception:  # advice asks the system, too
        return PrivilegeResult(name, False, f"it was refused ({error.strerror or error})")


def call_c(name: str, *arguments: int) -> int:
    """Calls a function of the C library that Python's standard library does not offer. Raises OSError with its errno
    where it returns -1, with ENOSYS where there is no such function."""
    function = getattr(ctypes.CDLL(None, use_errno=True), name, None)
    if function is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS), name)
    # prctl takes any number of arguments and reads each of them as an unsigned long.
    result = int(function(*map(ctypes.c_ulong, arguments)))
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), name)
    return result


def is_root() -> bool:
    """Whether the user is root. Decides what is advised, never what is tried."""
    return os.geteuid() == 0


def what_grants(capability: str, item: str, value: str) -> str:
    """Returns what grants a capability, or enough of the limit `item`, to follow "it takes"."""
    if is_root():
        return f"{capability} (in a container: --cap-add={capability.removeprefix('CAP_')})"
    return f"{login_limit(item, value)}, or {capability}, or root"


def login_limit(item: str, value: str) -> str:
    """Returns what raises this user's limit on `item`, as in limits.conf(5), to follow "it takes"."""
    import pwd

    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a user of a container need not be in its list
        user = "*"
    return f"the line '{user} - {item} {value}' in /etc/security/limits.d/hapsim.conf and a new login"
