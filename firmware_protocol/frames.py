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
from firmware_protocol.compiled import inlined, jit_inlined
from firmware_protocol.crc import crc16_dnp, crc32_c
from firmware_protocol.unsigned import ONE

Integers = Sequence[int] | NDArray[np.int64]


class Format(NamedTuple):
    """How frames look. Made by `armed_format`."""

    channels: int
    velocity: bool
    """Whether frames to the host carry a velocity beside each position."""
    long_check: bool
    """Whether the check has 32 bits."""
    seed: int
    """Its start value."""


SETUP = Format(1, False, False, schema.SETUP_SEED)
"""The format of describe, description, arm and of every frame of a device that is not armed."""


def armed_format(channels: int, velocity: bool = False) -> Format:
    """The format between arm and disarm of a device with 1 to 16 channels; `velocity`: where its velocities were asked
    for. Raises ValueError for any other number of channels.
    """
    if not 1 <= channels <= schema.MAX_CHANNELS:
        raise ValueError(f"{channels} channels: the protocol carries 1 to {schema.MAX_CHANNELS}")
    long_check = schema.has_long_check(channels, velocity)
    if velocity:
        seed = schema.VELOCITY_SEED_LONG if long_check else schema.VELOCITY_SEED_SHORT
    else:
        seed = schema.ARMED_SEED_LONG if long_check else schema.ARMED_SEED_SHORT
    return Format(channels, velocity, long_check, seed)


@inlined
def words_of(wire, to_device):
    """Words of a frame's payload in one direction: to the host, velocities stand behind the positions."""
    return 2 * wire.channels if wire.velocity and not to_device else wire.channels


@inlined
def check_of(data, start, stop, long_check, seed):
    """The check of the encoded bytes data[start:stop]."""
    if long_check:
        return crc32_c(data, start, stop, seed)
    return crc16_dnp(data, start, stop, seed)


@inlined
def _put_header(buffer, at, frame_type, number):
    buffer[at] = (frame_type << 4) | ((number >> 8) & 0xF)
    buffer[at + ONE] = number & 0xFF
    return at + ONE + ONE


@inlined
def _put_payload(buffer, at, counts, words):
    for i in range(words):
        word = counts[i]
        for shift in range(0, 32, 8):
            buffer[at] = (word >> shift) & 0xFF
            at += ONE
    return at


@inlined
def _seal(wire, buffer, start, stop):
    """Stuffs the body, appends the check in seven-bit bytes that cannot be zero, and the delimiter."""
    stuff(buffer, start, stop)
    check = check_of(buffer, start, stop, wire.long_check, wire.seed)
    at = np.uint64(stop)
    for i in range(5 if wire.long_check else 3):
        buffer[at] = 0x80 | ((check >> np.uint32(7 * i)) & np.uint32(0x7F))
        at += ONE
    buffer[at] = 0
    return np.int64(at + ONE)


@jit_inlined
def write_to_host(wire, buffer, start, frame_type, number, counts):
    """Writes a frame of the device at buffer[start:] and returns where it ends. `counts`: int64, one per word."""
    at = _put_header(buffer, np.uint64(start + 1), frame_type, number)
    at = _put_payload(buffer, at, counts, words_of(wire, False))
    return _seal(wire, buffer, start, np.int64(at))


@jit_inlined
def write_to_device(wire, buffer, start, frame_type, number, argument, counts):
    """Writes a frame of the host at buffer[start:] and returns where it ends. `argument` is one byte."""
    at = _put_header(buffer, np.uint64(start + 1), frame_type, number)
    buffer[at] = argument & 0xFF
    at = _put_payload(buffer, at + ONE, counts, words_of(wire, True))
    return _seal(wire, buffer, start, np.int64(at))


def frame_to_host(wire: Format, frame_type: int, number: int, counts: Integers) -> bytes:
    """One frame of the device, as bytes. For set-up, tests and tools; the loops write into their own buffers.

    Raises ValueError where a field does not fit: what the compiled writers do then is cut it off.
    """
    words = _fitting(wire, False, frame_type, number, 0, counts)
    buffer = np.zeros(frame_bytes(wire, to_device=False), np.uint8)
    write_to_host(wire, buffer, 0, frame_type, number, words)
    return buffer.tobytes()


def frame_to_device(wire: Format, frame_type: int, number: int, argument: int, counts: Integers) -> bytes:
    """One frame of the host, as bytes. Raises ValueError where a field does not fit."""
    words = _fitting(wire, True, frame_type, number, argument, counts)
    buffer = np.zeros(frame_bytes(wire, to_device=True), np.uint8)
    write_to_device(wire, buffer, 0, frame_type, number, argument, words)
    return buffer.tobytes()


def frame_bytes(wire: Format, to_device: bool) -> int:
    """Bytes of a whole frame in this format, its delimiter included."""
    return schema.encoded_bytes(wire.channels, to_device, wire.velocity) + (5 if wire.long_check else 3) + 1


def _fitting(
    wire: Format, to_device: bool, frame_type: int, number: int, argument: int, counts: Integers
) -> NDArray[np.int64]:
    """The counts as the compiled writers want them, once every field was found to fit."""
    for name, value, bits in (("type", frame_type, 4), ("number", number, 12), ("argument", argument, 8)):
        if not 0 <= value < 1 << bits:
            raise ValueError(f"{name} {value}: a frame carries {bits} bits of it")
    words = np.asarray(counts, np.int64)
    expected = schema.words(wire.channels, to_device, wire.velocity)
    if words.shape != (expected,):
        raise ValueError(f"counts of shape {words.shape} where a frame carries {expected} word(s)")
    if words.size and not -(2**31) <= words.min() <= words.max() < 2**31:
        raise ValueError(f"counts {words.tolist()}: a frame carries 32 bits, signed")
    return words
