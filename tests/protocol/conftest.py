"""A decoder in plain Python, written from PROTOCOL.md and from nothing else: it shares no line with the codec.

And the codec itself both ways: as machine code, and as the plain Python that its pieces are when Python calls them.
"""

from __future__ import annotations

import json
import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

import firmware_protocol
from firmware_protocol.compiled import entry
from firmware_protocol.decoder import next_frame, next_frame_in
from firmware_protocol.frames import crc_of, stuff, unstuff, write_frame

PACKAGE = Path(firmware_protocol.__file__).parent
TYPES = {
    "to_device": {1: "describe", 2: "arm", 3: "force", 4: "disarm"},
    "to_host": {9: "description", 10: "position", 11: "position_held", 12: "status"},
}


def plain_crc(data: bytes, bits: int, start: int) -> int:
    """Section 2.3, bit by bit: CRC-16/DNP or CRC-32C."""
    reversed_polynomial, final_xor = {16: (0xA6BC, 0xFFFF), 32: (0x82F63B78, 0xFFFFFFFF)}[bits]
    crc = start
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ reversed_polynomial if crc & 1 else crc >> 1
    return crc ^ final_xor


def plain_unstuffed(encoded: bytes) -> bytes | None:
    """Section 2.2: the body, or None where the chain does not end at the end."""
    body, at = bytearray(encoded), 0
    while at < len(encoded):
        code = encoded[at]
        body[at] = 0
        at += code
        if code == 0 or at > len(encoded):
            return None
    return bytes(body[1:])


class PlainDecoder:
    """Section 2.5, for one direction; `wire` is an entry of the vectors' `formats`."""

    def __init__(self, wire: dict[str, Any], direction: str) -> None:
        self.direction = direction
        self.counters = Counter(accepted=0, crc_errors=0, length_errors=0, form_errors=0, garbage_bytes=0)
        self.use(wire)

    def use(self, wire: dict[str, Any]) -> None:
        self.wire, self.seen = wire, bytearray()

    def read(self, data: bytes) -> list[dict[str, Any]]:
        frames = []
        for byte in data:
            if byte:
                self.seen.append(byte)
                continue
            stretch, self.seen = bytes(self.seen), bytearray()
            frame = self._look_at(stretch) if stretch else None
            if frame is not None:
                frames.append(frame)
        return frames

    def _look_at(self, stretch: bytes) -> dict[str, Any] | None:
        bits = self.wire["check_bits"]
        encoded = 1 + 2 + (self.direction == "to_device") + 4 * self._words()
        length = encoded + {16: 3, 32: 5}[bits]
        if len(stretch) < length:
            self.counters["length_errors"] += 1
            return None
        self.counters["garbage_bytes"] += len(stretch) - length
        candidate = stretch[len(stretch) - length :]
        check = plain_crc(candidate[:encoded], bits, self.wire["seed"])
        if candidate[encoded:] != bytes(0x80 | (check >> 7 * i) & 0x7F for i in range(length - encoded)):
            self.counters["crc_errors"] += 1
            return None
        frame = self._fields(plain_unstuffed(candidate[:encoded]))
        self.counters["form_errors" if frame is None else "accepted"] += 1
        return frame

    def _words(self) -> int:
        wire = self.wire
        if self.direction == "to_host":
            each = 1 + wire["velocity"] + wire["acceleration"] + wire["hand_force"]
            return int(wire["channels"] * each + wire["inputs"])
        return int(wire["channels"] * (1 + 2 * wire["line"] + wire["command"]) + wire["outputs"])

    def _fields(self, body: bytes | None) -> dict[str, Any] | None:
        if body is None or body[0] >> 4 not in TYPES[self.direction]:
            return None
        frame: dict[str, Any] = {"type": TYPES[self.direction][body[0] >> 4]}
        frame["number"] = (body[0] & 0xF) << 8 | body[1]
        if self.direction == "to_device":
            frame["argument"] = body[2]
        payload = body[3:] if self.direction == "to_device" else body[2:]
        frame["payload"] = list(struct.unpack(f"<{self._words()}i", payload))
        return frame


class Codec(NamedTuple):
    """The pieces of the codec, run in one way."""

    stuff: Callable[..., None]
    unstuff: Callable[..., bool]
    crc_of: Callable[..., int]
    write_frame: Callable[..., int]
    next_frame: Callable[..., tuple[int, bool]]


@entry
def _stuff(buffer, start, stop):
    stuff(buffer, start, stop)


@entry
def _unstuff(buffer, start, stop):
    return unstuff(buffer, start, stop)


@entry
def _crc_of(which, data, start, stop, seed):
    return crc_of(which, data, start, stop, seed)


@entry
def _write_frame(framing, buffer, start, frame_type, number, argument, counts):
    return write_frame(framing, buffer, start, frame_type, number, argument, counts)


COMPILED = Codec(_stuff, _unstuff, _crc_of, _write_frame, next_frame_in)
PLAIN = Codec(stuff, unstuff, crc_of, write_frame, next_frame)


@pytest.fixture(scope="session")
def compiled_codec() -> Codec:
    return COMPILED


@pytest.fixture(scope="session")
def plain_codec() -> Codec:
    return PLAIN


@pytest.fixture(scope="session", params=[COMPILED, PLAIN], ids=["compiled", "plain"])
def codec(request: pytest.FixtureRequest) -> Codec:
    """Codec of the parameter, for properties that both must have."""
    chosen: Codec = request.param
    return chosen


@pytest.fixture(scope="session")
def plain_decoder() -> type[PlainDecoder]:
    return PlainDecoder


@pytest.fixture(scope="session")
def vectors() -> dict[str, Any]:
    """vectors.json, as another language would read it."""
    document: dict[str, Any] = json.loads((PACKAGE / "vectors.json").read_text("utf-8"))
    return document


@pytest.fixture(scope="session")
def formats(vectors: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """The vectors' formats by name."""
    return {wire["name"]: wire for wire in vectors["formats"]}
