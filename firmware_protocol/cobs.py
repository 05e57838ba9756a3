"""Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999), compiled, in place, for bodies of at most 253 bytes:
there the overhead is exactly one byte, so a frame's length says nothing of its content.
"""

from __future__ import annotations

from firmware_protocol.compiled import jit_inlined


@jit_inlined
def stuff(buffer, start, stop):
    """Encodes the body that stands in buffer[start + 1 : stop]; buffer[start] is the room for the first code."""
    last = start
    for i in range(start + 1, stop):
        if buffer[i] == 0:
            buffer[last] = i - last
            last = i
    buffer[last] = stop - last


@jit_inlined
def unstuff(buffer, start, stop):
    """Decodes buffer[start:stop]; the body is then buffer[start + 1 : stop]. False where the codes do not add up."""
    at = start
    while True:
        code = buffer[at]
        following = at + code
        if code == 0 or following > stop:
            return False
        if at > start:
            buffer[at] = 0
        if following == stop:
            return True
        at = following
