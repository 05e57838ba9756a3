"""The encoder, compiled: byte stuffing, checks, and the formats of frames (the number of channels and the check).

A device that is not armed speaks the setup format (one channel's length, a start value that never changes), an armed
one the format of its channels. Within a format every frame in one direction has the same length, so a frame torn apart
by a flipped delimiter cannot be mistaken for another (PROTOCOL.md, section 15).

Consistent Overhead Byte Stuffing (Cheshire and Baker, 1999) works in place on bodies of at most 253 bytes. Up to there
it adds exactly one byte, so a frame's length does not depend on its content.

The checks are CRC-16/DNP and CRC-32C, reflected: a UART sends the least significant bit first, so bursts on the wire
are bursts in the check. Koopman's tables give them Hamming distance 6 up to 135 bits and up to 655 bytes of data; every
frame is shorter. Eight bytes at a time are looked up, each in the table of its distance from the end: one lookup then
does not wait for the one before.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import ONE, inlined, new_record

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


Integers = Sequence[int] | NDArray[np.int64]


class Format(NamedTuple):
    """The layout of frames; see `armed_format`."""

    channels: int
    parts: int
    """ARM's bits of what frames carry behind positions and forces."""
    long_check: bool
    """True if the check has 32 bits."""
    seed: int
    """The check's start value."""

    @property
    def part_names(self) -> list[str]:
        """Names of the parts on the wire, in their order."""
        return [part.name for part in schema.PARTS if part.bit & self.parts]

    def words(self, to_device: bool) -> int:
        """Returns the words of a payload in one direction."""
        return schema.words(self.channels, to_device, self.parts)


ROOM = 256
"""Bytes; no frame has more before its delimiter."""

SETUP = Format(1, 0, False, schema.SETUP_SEED)
"""The format of every frame of a device that is not armed, and of DESCRIBE and ARM."""

FRAMING = np.dtype(
    [
        ("from_host", np.int64),  # 1: frames carry an argument
        ("words", np.int64),  # of a payload
        ("long_check", np.int64),
        ("seed", np.int64),
    ],
    align=True,
)
"""A format in one direction, for compiled code."""


@cache
def armed_format(channels: int, parts: int = 0) -> Format:
    """Returns the format of an armed device with 1 to 16 channels and these `parts` (ARM's bits).

    Raises ValueError for any other number of channels, and for more than 62 words in a frame.
    """
    schema.require_words(channels, parts)
    long_check, word = schema.has_long_check(channels, parts), schema.seed_word(parts)
    return Format(channels, parts, long_check, word if long_check else schema.folded(word))


def every_armed_format() -> list[Format]:
    """Returns the formats of all armed devices: of any number of channels, with any parts that fit into a frame."""
    channels = range(1, schema.MAX_CHANNELS + 1)
    return [armed_format(n, parts) for parts in schema.COMBINATIONS for n in channels if schema.fits(n, parts)]


@cache
def framing_of(wire: Format, to_device: bool) -> Any:
    """Returns the FRAMING of a format in one direction, to be read and copied only."""
    framing = new_record(FRAMING)
    framing.from_host = to_device
    framing.words = wire.words(to_device)
    framing.long_check = wire.long_check
    framing.seed = wire.seed
    return framing


@inlined
def write_frame(framing, buffer, start, frame_type, number, argument, counts):
    """Writes a frame at buffer[start:] and returns where it ends, each field cut to its bits. `counts`: int64, one per
    word; `argument`: only in a frame to the device."""
    first = np.uint64(start)
    at = first + ONE
    buffer[at] = (frame_type << 4) | ((number >> 8) & 0xF)
    buffer[at + ONE] = number & 0xFF
    at += ONE + ONE
    if framing.from_host:
        buffer[at] = argument & 0xFF
        at += ONE
    for i in range(np.uint64(framing.words)):
        word = counts[i]
        for shift in range(0, 32, 8):
            buffer[at] = (word >> shift) & 0xFF
            at += ONE
    stuff(buffer, first, at)
    # The check goes in bytes of seven bits that cannot be zero; the delimiter behind it is.
    check = crc_of(framing.long_check, buffer, first, at, framing.seed)
    for i in range(5 if framing.long_check else 3):
        buffer[at] = 0x80 | ((check >> np.uint32(7 * i)) & np.uint32(0x7F))
        at += ONE
    buffer[at] = 0
    return np.int64(at + ONE)


def frame_to_host(wire: Format, frame_type: int, number: int, counts: Integers) -> bytes:
    """Returns one frame of the device, for set-up, tests and tools. Raises ValueError where a field does not fit."""
    return _frame(wire, False, frame_type, number, 0, counts)


def frame_to_device(wire: Format, frame_type: int, number: int, argument: int, counts: Integers) -> bytes:
    """Returns one frame of the host. Raises ValueError where a field does not fit."""
    return _frame(wire, True, frame_type, number, argument, counts)


def frame_bytes(wire: Format, to_device: bool) -> int:
    """Returns the bytes of a whole frame in this format, with its delimiter."""
    return schema.frame_bytes(wire.channels, to_device, wire.parts)


def _frame(wire: Format, to_device: bool, frame_type: int, number: int, argument: int, counts: Integers) -> bytes:
    for name, value, bits in (("type", frame_type, 4), ("number", number, 12), ("argument", argument, 8)):
        if not 0 <= value < 1 << bits:
            raise ValueError(f"{name} {value}: a frame carries {bits} bits of it")
    framing, words = framing_of(wire, to_device), np.asarray(counts, np.int64)
    if words.shape != (framing.words,):
        raise ValueError(f"counts of shape {words.shape} where a frame carries {framing.words} word(s)")
    if not -(2**31) <= words.min() <= words.max() < 2**31:
        raise ValueError(f"counts {words.tolist()}: a frame carries 32 bits, signed")
    buffer = np.zeros(ROOM, np.uint8)
    end = write_frame(framing, buffer, 0, frame_type, number, argument, words)
    return buffer[:end].tobytes()
