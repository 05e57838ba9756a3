"""Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999), compiled, in place, for bodies of at most 253 bytes:
there the overhead is exactly one byte, so a frame's length says nothing of its content.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol.compiled import inlined
from firmware_protocol.unsigned import ONE


@inlined
def stuff(buffer, start, stop):
    """Encodes the body that stands in buffer[start + 1 : stop]; buffer[start] is the room for the first code."""
    last, end = np.uint64(start), np.uint64(stop)
    at = last + ONE
    while at < end:
        if buffer[at] == 0:
            buffer[last] = at - last
            last = at
        at += ONE
    buffer[last] = end - last


@inlined
def unstuff(buffer, start, stop):
    """Decodes buffer[start:stop]; the body is then buffer[start + 1 : stop]. False where the codes do not add up."""
    begun, end = np.uint64(start), np.uint64(stop)
    at = begun
    while True:
        code = np.uint64(buffer[at])
        following = at + code
        if code == 0 or following > end:
            return False
        if at > begun:
            buffer[at] = 0
        if following == end:
            return True
        at = following
