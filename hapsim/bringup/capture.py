"""Decodes a capture of the wire: raw bytes of one direction, or of both, in any format.

Between two delimiters is a frame, or bytes that are refused. Length and check tell the format and the sender: every
format is tried, those that were heard before first. What is kept does not grow with the capture.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.frames import SETUP, Format, armed_format, frame_bytes

KEPT = 256
"""Bytes that are kept of a stretch without a delimiter: its last; more than any frame has."""

_SHORTEST = frame_bytes(SETUP, to_device=False) - 1  # without the delimiter
_EVERY = (SETUP, *(armed_format(n, velocity) for velocity in (False, True) for n in range(1, schema.MAX_CHANNELS + 1)))


class Decoded(NamedTuple):
    """A frame."""

    offset: int
    """Of its first byte, from the capture's beginning."""
    from_host: bool
    wire: Format
    frame: Frame
    data: bytes
    """As it stood on the wire, without its delimiter."""


class Refused(NamedTuple):
    """Bytes between two delimiters that are no frame, or stood in front of one."""

    offset: int
    length: int
    reason: str
    """One of REASONS."""
    data: bytes
    """The last KEPT of them."""


REASONS = {
    "check": "the check is wrong: damaged, or of another schema",
    "short": "shorter than any frame",
    "form": "a right check over an unknown type, or over codes that do not add up",
    "garbage": "no frame has this length: noise, or frames that ran together",
    "unfinished": "the capture ends within it",
}
"""Why bytes are refused, in words."""


class Registers(dict[int, int]):
    """What a device said of itself: unsigned words, by number."""

    def note(self, frame: Frame) -> None:
        """Takes in a DESCRIPTION; any other frame says nothing here."""
        if frame.type == schema.DESCRIPTION:
            self[frame.number] = frame.counts[0] & 0xFFFFFFFF

    def scale(self, which: int, channel: int) -> float | None:
        """Returns a scale by its place among the channel's registers; None if the device did not describe it."""
        return self.number(schema.REG_CHANNEL + channel * schema.CHANNEL_WORDS + which)

    def number(self, register: int) -> float | None:
        """Returns an f64 in two registers; None if one of them is missing."""
        if register not in self or register + 1 not in self:
            return None
        value: float = struct.unpack("<d", struct.pack("<II", self[register], self[register + 1]))[0]
        return value


class Capture:
    """Reads a capture piece by piece. `counters`: what was found so far, by name; `registers`: what the device said of
    itself."""

    def __init__(self, senders: Sequence[bool] = (True, False)) -> None:
        """`senders`: whose frames to look for, True for the host's."""
        self.counters: Counter[str] = Counter()
        self.registers = Registers()
        self._by_length: dict[int, list[tuple[Format, bool, Any]]] = {}
        for wire in _EVERY:
            for from_host in senders:
                entry = (wire, from_host, new_decoder(wire, to_device=from_host))
                self._by_length.setdefault(frame_bytes(wire, from_host) - 1, []).append(entry)
        # The formats that were heard before, and how many frames in each. Everybody begins in the set-up format.
        self._known: dict[tuple[Format, bool], int] = {(SETUP, from_host): 0 for from_host in senders}
        self._tail = b""  # of the stretch that is not yet ended
        self._length = 0
        self._offset = 0  # of its first byte

    def feed(self, data: bytes) -> Iterator[Decoded | Refused]:
        """Yields what ends in the next piece of the capture."""
        self.counters["bytes"] += len(data)
        at = 0
        while (delimiter := data.find(b"\0", at)) >= 0:
            self._remember(data[at:delimiter])
            if self._length:
                yield from self._judge()
            self._offset += self._length + 1
            self._tail, self._length = b"", 0
            at = delimiter + 1
        self._remember(data[at:])

    def finish(self) -> Iterator[Refused]:
        """Yields the bytes that the capture ends within."""
        if self._length:
            yield self._refuse(self._offset, self._length, "unfinished", self._tail)
        self._tail, self._length = b"", 0

    def _remember(self, data: bytes) -> None:
        self._length += len(data)
        self._tail = (self._tail + data[-KEPT:])[-KEPT:]

    def _judge(self) -> Iterator[Decoded | Refused]:
        """Yields what is between two delimiters: a frame, or one behind garbage, in a format that was heard before."""
        found, reason = self._read(self._tail, self._length)
        if found is None and self._length > _SHORTEST:
            for length in sorted({frame_bytes(*known) - 1 for known in self._known}, reverse=True):
                if length < self._length and found is None:
                    found, _ = self._read(self._tail[-length:], length, known_only=True)
        if found is None:
            yield self._refuse(self._offset, self._length, reason, self._tail)
            return
        before = self._length - len(found.data)
        if before:
            yield self._refuse(self._offset, before, "garbage", self._tail[: -len(found.data)])
        self._learn(found)
        yield found

    def _read(self, data: bytes, length: int, known_only: bool = False) -> tuple[Decoded | None, str]:
        """Returns the frame that these bytes are as a whole, or why they are none."""
        candidates = self._by_length.get(length, []) if len(data) == length else []
        if not candidates:
            return None, "short" if length < _SHORTEST else "garbage"
        reason = "check"
        for wire, from_host, decoder in sorted(candidates, key=lambda one: -self._known.get(one[:2], 0)):
            if known_only and (wire, from_host) not in self._known:
                continue
            misshapen = int(decoder.form_errors)
            frames = frames_in(decoder, data + b"\0")
            if frames:
                offset = self._offset + self._length - length
                return Decoded(offset, from_host, wire, frames[0], data), ""
            reason = "form" if decoder.form_errors > misshapen else reason
        return None, reason

    def _refuse(self, offset: int, length: int, reason: str, data: bytes) -> Refused:
        self.counters[f"refused: {reason}"] += 1
        self.counters["refused bytes"] += length
        return Refused(offset, length, reason, data)

    def _learn(self, found: Decoded) -> None:
        key = (found.wire, found.from_host)
        self._known[key] = self._known.get(key, 0) + 1
        self.counters["from the host" if found.from_host else "from the device"] += 1
        self.registers.note(found.frame)
