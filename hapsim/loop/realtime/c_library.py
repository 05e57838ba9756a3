"""Calls that Python's standard library does not offer, made in the C library."""

from __future__ import annotations

import ctypes
import errno
import os


def call(name: str, *arguments: int) -> int:
    """What the C library's function `name` returns. Raises OSError with its errno where that is -1,
    with ENOSYS where there is no such function."""
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
