"""Calls that Python's standard library does not offer, made in the C library."""

from __future__ import annotations

import ctypes
import os


def call(name: str, *arguments: int) -> int:
    """What the C library's function `name` returns. Raises OSError with its errno where that is -1."""
    library = ctypes.CDLL(None, use_errno=True)
    # prctl takes any number of arguments and reads each of them as an unsigned long.
    result = int(getattr(library, name)(*map(ctypes.c_ulong, arguments)))
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), name)
    return result
