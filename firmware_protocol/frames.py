"""Writing frames, compiled. A `Format` says how frames look at the moment: for how many channels, with which check.

A device that is not armed speaks the setup format (one channel's length, a start value that never changes); an armed
one the format of its channels. Within a format every frame in one direction has the same length: that is what makes a
frame torn apart by a flipped delimiter impossible to mistake for another (PROTOCOL.md, "What is promised").
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.cobs import stuff
from firmware_protocol.compiled import jit
from firmware_protocol.crc import crc16_dnp, crc32_c

Integers = Sequence[int] | NDArray[np.int64]


class Format(NamedTuple):
    """How frames look: number of channels, whether the check has 32 bits, its start value. Made by `armed_format`."""

    channels: int
    long_check: bool
    seed: int


SETUP = Format(1, False, schema.SETUP_SEED)
"""The format of describe, description, arm and of every frame of a device that is not armed."""


def armed_format(channels: int) -> Format:
    """The format between arm and disarm of a device with 1 to 16 channels. Raises ValueError outside of that."""
    if not 1 <= channels <= schema.MAX_CHANNELS:
        raise ValueError(f"{channels} channels: the protocol carries 1 to {schema.MAX_CHANNELS}")
    long_check = channels > schema.SHORT_CRC_CHANNELS
    return Format(channels, long_check, schema.ARMED_SEED_LONG if long_check else schema.ARMED_SEED_SHORT)


@jit
def check_of(data, start, stop, long_check, seed):
    """The check of the encoded bytes data[start:stop]."""
    if long_check:
        return crc32_c(data, start, stop, seed)
    return crc16_dnp(data, start, stop, seed)


@jit
def _put_header(buffer, at, frame_type, number):
    buffer[at] = (frame_type << 4) | ((number >> 8) & 0xF)
    buffer[at + 1] = number & 0xFF
    return at + 2


@jit
def _put_payload(buffer, at, counts, channels):
    for c in range(channels):
        word = counts[c]
        for shift in range(0, 32, 8):
            buffer[at] = (word >> shift) & 0xFF
            at += 1
    return at


@jit
def _seal(wire, buffer, start, stop):
    """Stuffs the body, appends the check in seven-bit bytes that cannot be zero, and the delimiter."""
    stuff(buffer, start, stop)
    check = check_of(buffer, start, stop, wire.long_check, wire.seed)
    for i in range(5 if wire.long_check else 3):
        buffer[stop + i] = 0x80 | ((check >> np.uint32(7 * i)) & np.uint32(0x7F))
    stop += 5 if wire.long_check else 3
    buffer[stop] = 0
    return stop + 1


@jit
def write_to_host(wire, buffer, start, frame_type, number, counts):
    """Writes a frame of the device at buffer[start:] and returns where it ends. `counts`: int64, one per channel."""
    at = _put_header(buffer, start + 1, frame_type, number)
    at = _put_payload(buffer, at, counts, wire.channels)
    return _seal(wire, buffer, start, at)


@jit
def write_to_device(wire, buffer, start, frame_type, number, argument, counts):
    """Writes a frame of the host at buffer[start:] and returns where it ends. `argument` is one byte."""
    at = _put_header(buffer, start + 1, frame_type, number)
    buffer[at] = argument & 0xFF
    at = _put_payload(buffer, at + 1, counts, wire.channels)
    return _seal(wire, buffer, start, at)


def frame_to_host(wire: Format, frame_type: int, number: int, counts: Integers) -> bytes:
    """One frame of the device, as bytes. For set-up, tests and tools; the loops write into their own buffers.

    Raises ValueError where a field does not fit: what the compiled writers do then is cut it off.
    """
    words = _fitting(wire, frame_type, number, 0, counts)
    buffer = np.zeros(frame_bytes(wire, to_device=False), np.uint8)
    write_to_host(wire, buffer, 0, frame_type, number, words)
    return buffer.tobytes()


def frame_to_device(wire: Format, frame_type: int, number: int, argument: int, counts: Integers) -> bytes:
    """One frame of the host, as bytes. Raises ValueError where a field does not fit."""
    words = _fitting(wire, frame_type, number, argument, counts)
    buffer = np.zeros(frame_bytes(wire, to_device=True), np.uint8)
    write_to_device(wire, buffer, 0, frame_type, number, argument, words)
    return buffer.tobytes()


def frame_bytes(wire: Format, to_device: bool) -> int:
    """Bytes of a whole frame in this format, its delimiter included."""
    return schema.encoded_bytes(wire.channels, to_device) + (5 if wire.long_check else 3) + 1


def _fitting(wire: Format, frame_type: int, number: int, argument: int, counts: Integers) -> NDArray[np.int64]:
    """The counts as the compiled writers want them, once every field was found to fit."""
    for name, value, bits in (("type", frame_type, 4), ("number", number, 12), ("argument", argument, 8)):
        if not 0 <= value < 1 << bits:
            raise ValueError(f"{name} {value}: a frame carries {bits} bits of it")
    words = np.asarray(counts, np.int64)
    if words.shape != (wire.channels,):
        raise ValueError(f"counts of shape {words.shape} in a format of {wire.channels} channel(s)")
    if words.size and not -(2**31) <= words.min() <= words.max() < 2**31:
        raise ValueError(f"counts {words.tolist()}: a frame carries 32 bits, signed")
    return words
