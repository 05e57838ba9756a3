"""Byte stuffing and checks, compiled.

Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) works in place on bodies of at most 253 bytes. Up to there
it adds exactly one byte, so a frame's length does not depend on its content.

The checks are CRC-16/DNP and CRC-32C, reflected: a UART sends the least significant bit first, so bursts on the wire
are bursts in the check. Koopman's tables give them Hamming distance 6 up to 135 bits and up to 655 bytes of data; every
frame is shorter. Eight bytes at a time are looked up, each in the table of its distance from the end: one lookup then
does not wait for the one before.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import ONE, inlined

_AT_ONCE = np.uint64(8)  # bytes
_CRC_BYTES = np.uint64(4)  # of the register; CRC-16 uses half of it
_BYTE_BITS = np.uint64(8)


@inlined
def stuff(buffer, start, stop):
    """Encodes the body in buffer[start + 1 : stop]; buffer[start] is the room for the first code."""
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
    """Decodes buffer[start:stop] to a body in buffer[start + 1 : stop]. Returns whether the codes end at the end."""
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


def _tables(reflected_polynomial: int) -> NDArray[np.uint32]:
    """Entry [k, byte]: the effect on the check of a byte that k more bytes follow."""
    one_byte: NDArray[np.uint32] = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        one_byte = (one_byte >> np.uint32(1)) ^ (one_byte & np.uint32(1)) * np.uint32(reflected_polynomial)
    tables = [one_byte]
    while len(tables) < _AT_ONCE:
        tables.append((tables[-1] >> 8) ^ one_byte[tables[-1] & 0xFF])
    return np.stack(tables)


# CRC-16/DNP, 0x3D65, and CRC-32C, 0x1EDC6F41, their bits reversed.
_TABLES = np.stack([_tables(0xA6BC), _tables(0x82F63B78)])
_FINAL = np.array([0xFFFF, 0xFFFFFFFF], np.uint32)


@inlined
def crc_of(is_long, data, start, stop, seed):
    """Returns the check of data[start:stop] from start value `seed`: CRC-32C where `is_long`, else CRC-16/DNP."""
    at, end, crc = np.uint64(start), np.uint64(stop), np.uint32(seed)
    table = np.uint64(1) if is_long else np.uint64(0)
    tables = _TABLES[table]
    while at < end:
        count = end - at if end - at < _AT_ONCE else _AT_ONCE
        # The part of the register that the bytes do not reach.
        following = crc >> np.uint32(count * _BYTE_BITS) if count < _CRC_BYTES else np.uint32(0)
        for k in range(count):
            byte = np.uint32(data[at + k]) ^ (crc & np.uint32(0xFF))
            crc >>= np.uint32(8)
            following ^= tables[count - ONE - k, byte]
        crc = following
        at += count
    return crc ^ _FINAL[table]
