"""The decoder: frames out of a stream of bytes in pieces of any size, with anything between them. Compiled.

A frame is the last L bytes before a delimiter, where L is the one length that the format has in that direction. Bytes
before them, since the previous delimiter, are counted as garbage. So the first whole frame after garbage of any length
is found without a second delimiter on the wire. Fewer than L bytes are never a frame.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import ONE, entry, inlined, new_record
from firmware_protocol.frames import FRAMING, ROOM, Format, crc_of, framing_of, unstuff

_RING = np.uint64(ROOM - 1)  # ROOM is a power of two

DECODER = np.dtype(
    [
        ("framing", FRAMING),
        ("seen", np.int64),  # bytes since the last delimiter
        ("accepted", np.int64),
        ("crc_errors", np.int64),
        ("length_errors", np.int64),  # fewer bytes between two delimiters than a frame has
        ("form_errors", np.int64),  # a right check over an unknown type or a wrong COBS chain
        ("garbage_bytes", np.int64),
        ("type", np.int64),  # of the last accepted frame, and its fields:
        ("number", np.int64),
        ("argument", np.int64),
        ("counts", np.int64, schema.MAX_WORDS),
        ("recent", np.uint8, ROOM),  # a ring of the last of them
        ("frame", np.uint8, ROOM),
    ],
    align=True,
)


class Frame(NamedTuple):
    """An accepted frame. A frame to the host has the argument 0."""

    type: int
    number: int
    argument: int
    counts: tuple[int, ...]


def new_decoder(wire: Format, to_device: bool) -> Any:
    """Returns a DECODER for one direction; `to_device`: for frames of the host."""
    decoder = new_record(DECODER)
    decoder.framing = framing_of(wire, to_device)
    return decoder


def use_format(decoder: Any, wire: Format) -> None:
    """Expects frames of this format from the next byte on. The bytes of an unfinished frame are dropped."""
    use_framing(decoder, framing_of(wire, bool(decoder.framing.from_host)))


def frames_in(decoder: Any, data: bytes) -> list[Frame]:
    """Returns every frame that ends in `data`. For tests and tools; the loops call `next_frame` on their buffers."""
    buffer = np.frombuffer(bytearray(data), np.uint8)
    frames = []
    at, found = next_frame_in(decoder, buffer, 0, buffer.size)
    while found:
        counts = tuple(decoder.counts[: decoder.framing.words].tolist())
        frames.append(Frame(int(decoder.type), int(decoder.number), int(decoder.argument), counts))
        at, found = next_frame_in(decoder, buffer, at, buffer.size)
    return frames


@entry
def next_frame_in(decoder, data, start, stop):
    """`next_frame`, callable from Python."""
    return next_frame(decoder, data, start, stop)


@inlined
def use_framing(decoder, framing):
    """`use_format` in compiled code. `framing`: of the decoder's own direction."""
    decoder.framing.words = framing.words
    decoder.framing.long_check = framing.long_check
    decoder.framing.seed = framing.seed
    decoder.seen = 0


@inlined
def next_frame(decoder, data, start, stop):
    """Reads data[start:stop] up to the end of the first valid frame.

    Returns (where reading stopped, whether a frame was found). The frame is then in the decoder's `type`, `number`,
    `argument` and `counts`. Without one, all was read and the beginning of a frame is remembered.
    """
    body = np.uint64(1 + 2 + decoder.framing.from_host + 4 * decoder.framing.words)
    length = body + (np.uint64(5) if decoder.framing.long_check else np.uint64(3))
    at, end, seen = np.uint64(start), np.uint64(stop), np.uint64(decoder.seen)
    recent, frame = decoder.recent, decoder.frame
    while at < end:
        byte = data[at]
        at += ONE
        if byte != 0:
            recent[seen & _RING] = byte
            seen += ONE
            continue
        had, seen = seen, np.uint64(0)
        if had >= length:
            first = had - length
            for i in range(length):
                frame[i] = recent[(first + i) & _RING]
            decoder.garbage_bytes += np.int64(first)
            if _accept(decoder, body):
                decoder.seen = 0
                return np.int64(at), True
        elif had > 0:
            decoder.length_errors += 1
    decoder.seen = np.int64(seen)
    return stop, False


@inlined
def _accept(decoder, body):
    """Returns whether the bytes in `frame`, `body` of them encoded, are a frame; its content is then in the decoder.

    Every bit of the check's bytes is compared, the constant ones too.
    """
    frame, framing = decoder.frame, decoder.framing
    check = crc_of(framing.long_check, frame, np.uint64(0), body, framing.seed)
    at = body
    for i in range(5 if framing.long_check else 3):
        if frame[at] != (0x80 | ((check >> np.uint32(7 * i)) & np.uint32(0x7F))):
            decoder.crc_errors += 1
            return False
        at += ONE
    fits = unstuff(frame, np.uint64(0), body)
    kind = np.int64(frame[1]) >> 4
    first, last = (schema.DESCRIBE, schema.DISARM) if framing.from_host else (schema.DESCRIPTION, schema.STATUS)
    if not fits or kind < first or kind > last:
        decoder.form_errors += 1
        return False
    decoder.accepted += 1
    decoder.type = kind
    decoder.number = ((np.int64(frame[1]) & 0xF) << 8) | np.int64(frame[2])
    at = np.uint64(3)
    if framing.from_host:
        decoder.argument = frame[3]
        at += ONE
    for k in range(np.uint64(framing.words)):
        word = np.int64(0)
        for shift in range(0, 32, 8):
            word |= np.int64(frame[at]) << shift
            at += ONE
        decoder.counts[k] = word - ((word & 0x80000000) << 1)
    return True
