"""Reading frames out of a stream of bytes, compiled: split anywhere, with anything between them.

A frame is the last L bytes before a delimiter, where L is the one length that the format has in that direction. What
stands before them since the delimiter before is garbage, counted and passed over: so the first whole frame after
garbage of any length is found, without a second delimiter on the wire. Fewer than L bytes are never a frame.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import ONE, entry, helper, inlined, new_record, out_of_line
from firmware_protocol.encoding import crc_of, unstuff
from firmware_protocol.frames import FRAMING, ROOM, Format, framing_of

DECODER = np.dtype(
    [
        ("framing", FRAMING),
        ("seen", np.int64),  # bytes since the last delimiter
        ("accepted", np.int64),
        ("crc_errors", np.int64),
        ("length_errors", np.int64),  # fewer bytes than a frame has between two delimiters
        ("form_errors", np.int64),  # a right check over wrong content: unknown type, codes that do not add up
        ("garbage_bytes", np.int64),
        ("type", np.int64),  # of the last accepted frame, with what it carried:
        ("number", np.int64),
        ("argument", np.int64),
        ("counts", np.int64, schema.MAX_WORDS),
        ("recent", np.uint8, ROOM),  # the last of the bytes that were seen, as many as a frame may have
        ("frame", np.uint8, ROOM),
    ],
    align=True,
)


class Frame(NamedTuple):
    """An accepted frame. `argument` is 0 in a frame to the host, which carries none."""

    type: int
    number: int
    argument: int
    counts: tuple[int, ...]


def new_decoder(wire: Format, to_device: bool) -> Any:
    """A decoder for the frames of one direction: `to_device` for what the host writes."""
    decoder = new_record(DECODER)
    begin_decoding(decoder, wire, to_device)
    return decoder


def begin_decoding(decoder: Any, wire: Format, to_device: bool) -> None:
    """Makes a decoder of a record of zeros."""
    decoder.framing = framing_of(wire, to_device)


def use_format(decoder: Any, wire: Format) -> None:
    """From the next byte on, expect frames of this format. Bytes of an unfinished frame are forgotten."""
    use_framing(decoder, framing_of(wire, bool(decoder.framing.from_host)))


def frames_in(decoder: Any, data: bytes) -> list[Frame]:
    """Every frame that ends in `data`. For tests and tools; the loops call `next_frame` on their own buffers."""
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
    """`use_format` in compiled code: `framing` is the format in the decoder's own direction."""
    decoder.framing.words = framing.words
    decoder.framing.long_check = framing.long_check
    decoder.framing.seed = framing.seed
    decoder.seen = 0


@inlined
def next_frame(decoder, data, start, stop):
    """Reads data[start:stop] up to the end of the first valid frame.

    Returns (where reading stopped, whether a frame was found). The frame is then in the decoder's `type`, `number`,
    `argument` and `counts`. Without one, everything was consumed and the beginning of a frame is remembered.
    """
    body = np.uint64(1 + 2 + decoder.framing.from_host + 4 * decoder.framing.words)
    length = body + (np.uint64(5) if decoder.framing.long_check else np.uint64(3))
    at, end = np.uint64(start), np.uint64(stop)
    while at < end:
        delimiter = at
        while delimiter < end and data[delimiter] != 0:
            delimiter += ONE
        if delimiter == end:
            _remember(decoder, data, at, end, length)
            break
        remembered = np.uint64(decoder.seen)
        seen = remembered + (delimiter - at)
        decoder.seen = 0
        if seen >= length:
            # The last bytes before the delimiter, of which some may only be remembered.
            here = _smaller(delimiter - at, length)
            before, first = length - here, _smaller(remembered, length) + here - length
            for i in range(before):
                decoder.frame[i] = decoder.recent[first + i]
            for i in range(here):
                decoder.frame[before + i] = data[delimiter - here + i]
            decoder.garbage_bytes += np.int64(seen - length)
            if _accept(decoder, body):
                return np.int64(delimiter + ONE), True
        elif seen > 0:
            decoder.length_errors += 1
        at = delimiter + ONE
    return stop, False


@helper
def _remember(decoder, data, at, end, length):
    """Keeps the beginning of a frame until the rest of it comes; of more bytes than a frame has, the last."""
    out_of_line()
    remembered, new = _smaller(np.uint64(decoder.seen), length), _smaller(end - at, length)
    kept = _smaller(remembered, length - new)
    for i in range(kept):
        decoder.recent[i] = decoder.recent[remembered - kept + i]
    for i in range(new):
        decoder.recent[kept + i] = data[end - new + i]
    decoder.seen += np.int64(end - at)


@inlined
def _smaller(one, other):
    return one if one < other else other


@inlined
def _accept(decoder, body):
    """Whether the bytes in `frame`, of which `body` are encoded, are a frame; what it carries is then in the decoder.

    Every bit of the check's bytes is looked at, the ones that are always set or clear too.
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
