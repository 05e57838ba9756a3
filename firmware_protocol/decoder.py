"""Reading frames out of a stream of bytes, compiled: split anywhere, with anything between them.

A frame is the last L bytes before a delimiter, where L is the one length that the format has in that direction. What
stands before them since the delimiter before is garbage, counted and passed over: so the first whole frame after
garbage of any length is found, without a second delimiter on the wire. Fewer than L bytes are never a frame.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.cobs import unstuff
from firmware_protocol.compiled import inlined, jit, jit_inlined
from firmware_protocol.frames import Format, check_of, words_of
from firmware_protocol.unsigned import ONE, copy, find_zero

_RECENT = 256  # a power of two above the longest frame

DECODER = np.dtype(
    [
        ("words", np.int64),  # of a payload in this direction
        ("long_check", np.int64),
        ("seed", np.int64),
        ("to_device", np.int64),
        ("seen", np.int64),  # bytes since the last delimiter
        ("at", np.int64),  # where the next byte goes in `recent`
        ("accepted", np.int64),
        ("crc_errors", np.int64),
        ("length_errors", np.int64),  # fewer bytes than a frame has between two delimiters
        ("form_errors", np.int64),  # a right check over wrong content: unknown type, codes that do not add up
        ("garbage_bytes", np.int64),
        ("type", np.int64),  # of the last accepted frame, with what it carried:
        ("number", np.int64),
        ("argument", np.int64),
        ("counts", np.int64, schema.MAX_WORDS),
        ("recent", np.uint8, _RECENT),
        ("frame", np.uint8, _RECENT),
    ],
    align=True,
)


class Frame(NamedTuple):
    """An accepted frame. `argument` is 0 in a frame to the host, which carries none."""

    type: int
    number: int
    argument: int
    counts: tuple[int, ...]


def new_decoder(wire: Format, to_device: bool) -> np.void:
    """A decoder for the frames of one direction: `to_device` for what the host writes."""
    decoder: np.void = np.zeros(1, DECODER)[0]
    decoder["to_device"] = to_device
    use_format(decoder, wire)
    return decoder


def frames_in(decoder: np.void, data: bytes) -> list[Frame]:
    """Every frame that ends in `data`. For tests and tools; the loops call `next_frame` on their own buffers."""
    buffer = np.frombuffer(bytearray(data), np.uint8)
    frames = []
    at, found = next_frame(decoder, buffer, 0, buffer.size)
    while found:
        counts = tuple(decoder["counts"][: decoder["words"]].tolist())
        frames.append(Frame(int(decoder["type"]), int(decoder["number"]), int(decoder["argument"]), counts))
        at, found = next_frame(decoder, buffer, at, buffer.size)
    return frames


@jit
def use_format(decoder, wire):
    """From the next byte on, expect frames of this format. Bytes of an unfinished frame are forgotten."""
    decoder.words = words_of(wire, decoder.to_device != 0)
    decoder.long_check = 1 if wire.long_check else 0
    decoder.seed = wire.seed
    decoder.seen = 0


@jit_inlined
def next_frame(decoder, data, start, stop):
    """Reads data[start:stop] up to the end of the first valid frame.

    Returns (where reading stopped, whether a frame was found). The frame is then in the decoder's `type`, `number`,
    `argument` and `counts`. Without one, everything was consumed and the beginning of a frame is remembered.
    """
    while True:
        delimiter = find_zero(data, start, stop)
        if delimiter == stop:
            _remember(decoder, data, start, stop)
            return stop, False
        if _accept(decoder, data, start, delimiter):
            return delimiter + 1, True
        start = delimiter + 1


@inlined
def _remember(decoder, data, start, stop):
    """Keeps the beginning of a frame until the rest of it comes; of more bytes than fit, the last."""
    for i in range(max(start, stop - _RECENT), stop):
        decoder.recent[decoder.at] = data[i]
        decoder.at = (decoder.at + 1) & (_RECENT - 1)
    decoder.seen += stop - start


@inlined
def _accept(decoder, data, start, stop):
    """Looks at the last L bytes before a delimiter, which end with data[start:stop]; fills in the frame where they are
    one."""
    check_bytes = 5 if decoder.long_check else 3
    body = 1 + 2 + decoder.to_device + 4 * decoder.words
    length = body + check_bytes
    seen = decoder.seen + stop - start
    decoder.seen = 0
    if seen == 0:
        return False
    if seen < length:
        decoder.length_errors += 1
        return False
    decoder.garbage_bytes += seen - length
    frame = decoder.frame
    remembered = max(length - (stop - start), 0)
    first = decoder.at - remembered
    for i in range(remembered):
        frame[i] = decoder.recent[(first + i) & (_RECENT - 1)]
    copy(data, stop - length + remembered, frame, remembered, length - remembered)
    if not _check_holds(frame, body, decoder.long_check != 0, decoder.seed):
        decoder.crc_errors += 1
        return False
    if not unstuff(frame, 0, body) or not _read(decoder, frame):
        decoder.form_errors += 1
        return False
    decoder.accepted += 1
    return True


@inlined
def _check_holds(frame, body, long_check, seed):
    """Every bit of the check's bytes is looked at, the ones that are always set or clear too."""
    check = check_of(frame, 0, body, long_check, seed)
    at = np.uint64(body)
    for i in range(5 if long_check else 3):
        if frame[at] != (0x80 | ((check >> np.uint32(7 * i)) & np.uint32(0x7F))):
            return False
        at += ONE
    return True


@inlined
def _read(decoder, frame):
    """Fields of the body in frame[1:]; False where the type is none of this direction's."""
    kind = np.int64(frame[1]) >> 4
    if decoder.to_device:
        known = schema.DESCRIBE <= kind <= schema.DISARM
    else:
        known = schema.DESCRIPTION <= kind <= schema.STATUS
    if not known:
        return False
    decoder.type = kind
    decoder.number = ((np.int64(frame[1]) & 0xF) << 8) | np.int64(frame[2])
    at = np.uint64(3)
    if decoder.to_device:
        decoder.argument = frame[3]
        at += ONE
    for k in range(decoder.words):
        word = np.int64(0)
        for shift in range(0, 32, 8):
            word |= np.int64(frame[at]) << shift
            at += ONE
        decoder.counts[k] = word - ((word & 0x80000000) << 1)
    return True
