"""Unsigned numbers for the indices of hot loops: a signed index may count from the end, and compiled code looks whether
it does at every access. Signed and unsigned must not be mixed: numba makes a floating-point number of the two.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol.compiled import inlined

ONE = np.uint64(1)


@inlined
def copy(source, start, target, first, count):
    """target[first : first + count] = source[start : start + count], byte by byte."""
    come, go = np.uint64(start), np.uint64(first)
    for i in range(np.uint64(count)):
        target[go + i] = source[come + i]


@inlined
def find_zero(data, start, stop):
    """Where the first zero of data[start:stop] stands, or `stop`."""
    at, end = np.uint64(start), np.uint64(stop)
    while at < end and data[at] != 0:
        at += ONE
    return np.int64(at)
