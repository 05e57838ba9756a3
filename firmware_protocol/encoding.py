"""What makes bytes safe on the wire, compiled: byte stuffing and two checks.

Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) works in place on bodies of at most 253 bytes. There the
overhead is exactly one byte, so a frame's length says nothing of its content.

The checks are CRC-16/DNP and CRC-32C, reflected: a UART sends the least significant bit first, so bursts on the wire
are bursts in the check. Koopman's tables give polynomial 0x3D65 distance 6 up to 135 bits of data, and CRC-32C distance
6 up to 655 bytes. Every frame stays within. Up to eight bytes are looked up at once, each in the table of its distance
from the end: looked up one after the other, each would wait for the one before.
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


def _tables(reflected_polynomial: int) -> NDArray[np.uint32]:
    """Entry [k, byte]: what a byte that k more bytes follow does to the check."""
    tables = np.zeros((int(_AT_ONCE), 256), np.uint32)
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc >> 1) ^ (reflected_polynomial if crc & 1 else 0)
        tables[0, byte] = crc
    for k in range(1, int(_AT_ONCE)):
        tables[k] = (tables[k - 1] >> 8) ^ tables[0, tables[k - 1] & 0xFF]
    return tables


# CRC-16/DNP, 0x3D65, and CRC-32C, 0x1EDC6F41, their bits reversed.
_TABLES = np.stack([_tables(0xA6BC), _tables(0x82F63B78)])
_FINAL = np.array([0xFFFF, 0xFFFFFFFF], np.uint32)
_DNP, _CASTAGNOLI = 0, 1


@inlined
def crc16_dnp(data, start, stop, seed):
    """CRC-16/DNP of data[start:stop] from start value `seed` (0: the catalogued one)."""
    return crc_of(_DNP, data, start, stop, seed)


@inlined
def crc32_c(data, start, stop, seed):
    """CRC-32C of data[start:stop] from start value `seed` (0xFFFFFFFF: the catalogued one)."""
    return crc_of(_CASTAGNOLI, data, start, stop, seed)


@inlined
def crc_of(which, data, start, stop, seed):
    """The check of data[start:stop]: CRC-32C where `which` is not 0, else CRC-16/DNP."""
    at, end, crc = np.uint64(start), np.uint64(stop), np.uint32(seed)
    table = np.uint64(1) if which else np.uint64(0)
    tables = _TABLES[table]
    while at < end:
        count = end - at if end - at < _AT_ONCE else _AT_ONCE
        # What the bytes do not reach.
        following = crc >> np.uint32(count * _BYTE_BITS) if count < _CRC_BYTES else np.uint32(0)
        for k in range(count):
            byte = np.uint32(data[at + k]) ^ (crc & np.uint32(0xFF))
            crc >>= np.uint32(8)
            following ^= tables[count - ONE - k, byte]
        crc = following
        at += count
    return crc ^ _FINAL[table]
