"""Test vectors for implementations in other languages, made by the codec: fields beside the bytes that carry them.

`make_vectors` writes them to vectors.json; PROTOCOL.md ("Test vectors") explains the entries. Everything is chosen by
rule, nothing by chance, so that the file changes only when the protocol does.
"""

from __future__ import annotations

from itertools import cycle, islice
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder, use_format
from firmware_protocol.encoding import crc16_dnp, crc32_c, crc_of, stuff
from firmware_protocol.frames import (
    SETUP,
    Format,
    armed_format,
    frame_bytes,
    frame_to_device,
    frame_to_host,
)

CHANNELS = (1, 3, 4, 16)
VELOCITY_CHANNELS = (1, 2, 16)
FORMATS = (
    {"setup": SETUP}
    | {f"armed_{channels}": armed_format(channels) for channels in CHANNELS}
    | {f"velocity_{channels}": armed_format(channels, velocity=True) for channels in VELOCITY_CHANNELS}
)
TO_DEVICE = {"describe": schema.DESCRIBE, "arm": schema.ARM, "force": schema.FORCE, "disarm": schema.DISARM}
TO_HOST = {
    "description": schema.DESCRIPTION,
    "position": schema.POSITION,
    "position_held": schema.POSITION_HELD,
    "status": schema.STATUS,
}
TYPES = TO_DEVICE | TO_HOST
NAMES = {code: name for name, code in TYPES.items()}
COUNTERS = ("accepted", "crc_errors", "length_errors", "form_errors", "garbage_bytes")

_WORDS = (0, -1, 2**31 - 1, -(2**31), 1, 256, 0x01010101, -0x01010102, 0x00FF00FF, 1_000_000, -1_000_000, 0x12345678)
_NUMBERS = (0, 4095, 1, 256, 255, 3840, 2048, 1234)
_ARGUMENTS = (0, 255, 20, 1)

Entry = dict[str, Any]


def vectors() -> Entry:
    """All of vectors.json."""
    return {
        "about": "Test vectors of the hapsim wire protocol; PROTOCOL.md explains them. Bytes are hexadecimal.",
        "version": schema.VERSION,
        "schema_hash": schema.SCHEMA_HASH,
        "formats": [_format_entry(name) for name in FORMATS],
        "crc": _crc_vectors(),
        "cobs": _cobs_vectors(),
        "frames": _frame_vectors(),
        "streams": _stream_vectors(),
        "refused": _refused_vectors(),
    }


def frame(format_name: str, kind: str, number: int, argument: int, counts: list[int]) -> bytes:
    """One frame by the names that the vectors use; `argument` is left out of a frame to the host."""
    wire = FORMATS[format_name]
    if kind in TO_DEVICE:
        return frame_to_device(wire, TO_DEVICE[kind], number, argument, counts)
    return frame_to_host(wire, TO_HOST[kind], number, counts)


def words_in(format_name: str, kind: str) -> int:
    """Words in the payload of a frame, by the names that the vectors use."""
    wire = FORMATS[format_name]
    return schema.words(wire.channels, kind in TO_DEVICE, wire.velocity)


def reading(about: str, direction: str, steps: list[tuple[str, bytes]]) -> Entry:
    """A vector of what a decoder makes of bytes: each step chooses a format, then reads a chunk."""
    decoder = new_decoder(FORMATS[steps[0][0]], direction == "to_device")
    before, read = steps[0][0], []
    for format_name, chunk in steps:
        if format_name != before:
            use_format(decoder, FORMATS[format_name])
            before = format_name
        read += frames_in(decoder, chunk)
    return {
        "about": about,
        "direction": direction,
        "steps": [{"format": name, "bytes": chunk.hex()} for name, chunk in steps],
        "frames": [_fields(NAMES[f.type], f.number, f.argument, list(f.counts)) for f in read],
        "counters": {counter: int(decoder[counter]) for counter in COUNTERS},
    }


def sealed(wire: Format, encoded: bytes) -> bytes:
    """Encoded bytes with the check that belongs to them, whatever they are, and the delimiter."""
    check = int(crc_of(wire.long_check, np.frombuffer(encoded, np.uint8), 0, len(encoded), wire.seed))
    return encoded + bytes(0x80 | check >> 7 * i & 0x7F for i in range(5 if wire.long_check else 3)) + b"\0"


def _fields(kind: str, number: int, argument: int, counts: list[int]) -> Entry:
    fields: Entry = {"type": kind, "number": number}
    if kind in TO_DEVICE:
        fields["argument"] = argument
    return fields | {"payload": counts}


def _format_entry(name: str) -> Entry:
    wire = FORMATS[name]
    return {
        "name": name,
        "channels": wire.channels,
        "velocity": wire.velocity,
        "check_bits": 32 if wire.long_check else 16,
        "seed": wire.seed,
        "bytes_to_device": frame_bytes(wire, to_device=True),
        "bytes_to_host": frame_bytes(wire, to_device=False),
    }


def _crc_vectors() -> list[Entry]:
    texts = [b"", b"\0", b"123456789", bytes(range(1, 69)), b"\xff" * 16]
    checks = (("crc16_dnp", crc16_dnp, (0, schema.SETUP_SEED)), ("crc32_c", crc32_c, (0xFFFFFFFF, schema.SCHEMA_HASH)))
    return [
        {
            "check": name,
            "seed": seed,
            "bytes": text.hex(),
            "value": int(compute(np.frombuffer(text, np.uint8), 0, len(text), seed)),
        }
        for name, compute, seeds in checks
        for seed in seeds
        for text in texts
    ]


def _cobs_vectors() -> list[Entry]:
    bodies = [b"", b"\0", b"\0\0", b"\1", b"\1\0", b"\0\1", bytes([17, 34, 0, 51]), bytes(68), b"\xff" * 68]
    bodies += [bytes(range(68)), bytes(range(1, 254)), bytes(253)]
    return [{"body": body.hex(), "encoded": _stuffed(body).hex()} for body in bodies]


def _stuffed(body: bytes) -> bytes:
    buffer = np.frombuffer(bytearray(b"\0" + body), np.uint8)
    stuff(buffer, 0, buffer.size)
    return buffer.tobytes()


def _frame_vectors() -> list[Entry]:
    numbers, arguments, words = cycle(_NUMBERS), cycle(_ARGUMENTS), cycle(_WORDS)
    entries = []
    for name in FORMATS:
        for kind in TYPES:
            for _ in range(3):
                fields = (kind, next(numbers), next(arguments), list(islice(words, words_in(name, kind))))
                next(words)  # so that no word stands in the same channel for ever
                entries.append({"format": name} | _fields(*fields) | {"bytes": frame(name, *fields).hex()})
    return entries


def _stream_vectors() -> list[Entry]:
    entries = []
    for name, direction, kind in (
        ("setup", "to_device", "describe"),
        ("armed_1", "to_host", "position"),
        ("armed_1", "to_device", "force"),
        ("armed_4", "to_device", "force"),
        ("armed_16", "to_host", "position_held"),
        ("velocity_1", "to_host", "position"),
        ("velocity_2", "to_device", "force"),
        ("velocity_16", "to_host", "position"),
    ):
        frames = [frame(name, kind, n, 9, [n - 2] * words_in(name, kind)) for n in (1, 2, 3)]
        entries += [reading(about, direction, [(name, c) for c in chunks]) for about, chunks in _streams_of(frames)]
    return entries + _arming_streams()


def _streams_of(frames: list[bytes]) -> list[tuple[str, list[bytes]]]:
    """One mishap on the wire after another, each among three whole frames."""
    first, second, third = frames
    return [
        ("three frames in one read", [first + second + third]),
        ("one byte at a time", [bytes([byte]) for byte in first + second]),
        ("reading begins in the middle of a frame", [first[4:] + second, third]),
        ("a text without a delimiter before the first frame", [b"boot: ready\r\n", first]),
        ("noise with delimiters in it", [bytes([0, 7, 0, 0, 255, 1, 0]) + first]),
        ("a thousand bytes of noise without a delimiter", [bytes([200, 17, 4, 99]) * 250, first]),
        ("noise of one delimiter after another", [b"\0" * 5 + first + b"\0" * 3 + second]),
        ("a delimiter was lost: two frames run together", [first[:-1] + second + third]),
        ("a delimiter was flipped", [first[:-1] + b"\x10" + second + third]),
        ("a byte was lost", [first + second[:3] + second[4:] + third]),
        ("a byte came twice", [first + second[:3] + second[2:] + third]),
        ("a byte became a delimiter", [first + second[:3] + b"\0" + second[4:] + third]),
        ("the wire broke in the middle of a frame", [first + second[:5], b"\0" + third]),
    ]


def _arming_streams() -> list[Entry]:
    """What the host reads around arming and a fault, in both formats, without velocities and with them."""
    fault = schema.LATCHED | schema.HOST_QUIET << 8
    armed = ("setup", frame("setup", "status", 0, 0, [schema.ARMED]))
    latched = ("setup", frame("setup", "status", 2, 0, [fault]))
    streams = []
    for name, first, second, cut_off, about in (
        (
            "armed_3",
            [5, -5, 0],
            [6, -6, 0],
            frame("armed_3", "position", 3, 0, [0, 0, 0])[:6],
            "arming, two positions, a fault; a frame begun in one format is forgotten in the next",
        ),
        ("velocity_1", [5, -500], [-6, 7], b"", "arming with velocities, two positions and their velocities, a fault"),
    ):
        positions = frame(name, "position", 0, 0, first) + frame(name, "position_held", 1, 0, second)
        last = frame(name, "status", 2, 0, [fault] + [0] * (len(first) - 1)) + cut_off
        streams.append(reading(about, "to_host", [armed, (name, positions), (name, last), latched]))
    return streams


def _refused_vectors() -> list[Entry]:
    entries = []
    for name, wire in FORMATS.items():
        for direction, kind, back in (("to_device", "force", "position"), ("to_host", "position", "force")):
            counts, counts_back = (list(islice(cycle(_WORDS), words_in(name, k))) for k in (kind, back))
            stories = _refused_of(wire, direction, frame(name, kind, 300, 20, counts))
            stories.append(("a frame of the other direction", frame(name, back, 300, 20, counts_back)))
            stories += [
                (f"a frame of the format {other}", frame(other, kind, 300, 20, [7] * words_in(other, kind)))
                for other in FORMATS
                if other != name
            ]
            entries += [reading(about, direction, [(name, data)]) for about, data in stories]
    return entries


def _refused_of(wire: Format, direction: str, good: bytes) -> list[tuple[str, bytes]]:
    """Ways to spoil a good frame, and frames that are good somewhere else."""
    checked = len(good) - (6 if wire.long_check else 4)
    last = len(good) - 2
    to_device = direction == "to_device"
    stranger = wire._replace(seed=wire.seed ^ 1)
    beyond = bytes([checked + 1]) + b"\x33" * (checked - 1)
    write = frame_to_device if to_device else frame_to_host
    zeros = [0] * schema.words(wire.channels, to_device, wire.velocity)
    fields = (300, 20, zeros) if to_device else (300, zeros)
    unknown = (0, 5, 8, 9, 15) if to_device else (0, 1, 8, 13, 15)
    return [
        ("one bit of the code is flipped", _flip(good, 0, 0x01)),
        ("one bit of the payload is flipped", _flip(good, checked - 1, 0x40)),
        ("one bit of the check is flipped", _flip(good, checked, 0x02)),
        ("a bit of the check that is always clear is set", _flip(good, last, 0x40)),
        ("the bit of a check's byte that is always set is clear", _flip(good, last, 0x80)),
        ("three bits are flipped", _flip(_flip(_flip(good, 1, 0x04), 2, 0x20), 5, 0x08)),
        ("the first byte is missing", good[1:]),
        ("the last byte before the delimiter is missing", good[:last] + good[last + 1 :]),
        ("another start value", write(stranger, 3 if to_device else 10, *fields)),
        (
            "a right check over a code that points beyond the end",
            sealed(wire, beyond),
        ),
        *((f"a right check over type {code:#x}", write(wire, code, *fields)) for code in unknown),
    ]


def _flip(data: bytes, at: int, bits: int) -> bytes:
    return data[:at] + bytes([data[at] ^ bits]) + data[at + 1 :]
