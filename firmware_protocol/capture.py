"""Decodes a capture of the wire: raw bytes of one direction, or of both, in any format.

Between two delimiters is a frame, or bytes that are refused. Length and check tell the format and the sender: every
format is tried, those that were heard before first. What is kept does not grow with the capture.
"""

from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple

from firmware_protocol import schema
from firmware_protocol.decoder import Frame, frames_in, new_decoder
from firmware_protocol.frames import SETUP, Format, every_armed_format, frame_bytes

KEPT = 256
"""Bytes that are kept of a stretch without a delimiter: its last; more than any frame has."""

_SHORTEST = frame_bytes(SETUP, to_device=False) - 1  # without the delimiter
_BY_LENGTH: dict[int, list[tuple[Format, bool]]] = {}
"""Formats and senders of the frames of a length, without the delimiter."""
for _wire in (SETUP, *every_armed_format()):
    for _from_host in (True, False):
        _BY_LENGTH.setdefault(frame_bytes(_wire, _from_host) - 1, []).append((_wire, _from_host))


class Decoded(NamedTuple):
    """A frame."""

    offset: int
    """Offset of the first byte from the capture's beginning."""
    from_host: bool
    wire: Format
    frame: Frame
    data: bytes
    """Bytes as on the wire, without the delimiter."""


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
"""Reason for rejecting bytes, in words."""


class Registers(dict[int, int]):
    """Registers that a device described: unsigned words, by number."""

    def note(self, frame: Frame) -> None:
        """Takes in a DESCRIPTION; any other frame says nothing here."""
        if frame.type == schema.DESCRIPTION:
            self[frame.number] = frame.counts[0] & 0xFFFFFFFF

    @property
    def motions(self) -> tuple[Literal["linear", "rotary"], ...]:
        """Motion of each channel; linear where the device declared none."""
        return schema.motions(self.get(schema.REG_ROTARY, 0), self.get(schema.REG_CHANNELS, 1) & 31)

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
    """Reads a capture piece by piece. `counters`: of what was found, by name; `registers`: as the device sent them."""

    def __init__(self, senders: Sequence[bool] = (True, False)) -> None:
        """`senders`: whose frames to look for, True for the host's."""
        self.counters: Counter[str] = Counter()
        self.registers = Registers()
        self._senders = senders
        self._decoders: dict[tuple[Format, bool], Any] = {}  # those that were tried
        # How many frames were heard in each format. A session begins in the set-up format.
        self._known: Counter[tuple[Format, bool]] = Counter({(SETUP, from_host): 0 for from_host in senders})
        self._tail = b""  # of the stretch that is not yet ended
        self._length = 0
        self._offset = 0  # of its first byte

    def feed(self, data: bytes) -> Iterator[Decoded | Refused]:
        """Yields what ends in the next piece of the capture."""
        self.counters["bytes"] += len(data)
        *ended, rest = data.split(b"\0")
        for stretch in ended:
            self._remember(stretch)
            if self._length:
                yield from self._read_stretch()
            self._offset += self._length + 1
            self._tail, self._length = b"", 0
        self._remember(rest)

    def finish(self) -> Iterator[Refused]:
        """Yields the bytes that the capture ends within."""
        if self._length:
            yield self._refuse(self._length, "unfinished", self._tail)
        self._tail, self._length = b"", 0

    def _remember(self, data: bytes) -> None:
        self._length += len(data)
        self._tail = (self._tail + data[-KEPT:])[-KEPT:]

    def _read_stretch(self) -> Iterator[Decoded | Refused]:
        """Yields what is between two delimiters: a frame, or one behind garbage, in a format that was heard before."""
        found, reason = self._read(self._length)
        known = {frame_bytes(*one) - 1 for one in self._known if found is None}
        for length in sorted((length for length in known if length < self._length), reverse=True):
            found = found or self._read(length, known_only=True)[0]
        if found is None:
            yield self._refuse(self._length, reason, self._tail)
            return
        before = self._length - len(found.data)
        if before:
            yield self._refuse(before, "garbage", self._tail[: -len(found.data)])
        self._known[found.wire, found.from_host] += 1
        self.counters["from the host" if found.from_host else "from the device"] += 1
        self.registers.note(found.frame)
        yield found

    def _read(self, length: int, known_only: bool = False) -> tuple[Decoded | None, str]:
        """Returns the frame that the last bytes are, or why they are none."""
        data = self._tail[-length:]
        candidates = [one for one in _BY_LENGTH.get(length, []) if one[1] in self._senders]
        reason = "check" if candidates else "short" if length < _SHORTEST else "garbage"
        for one in sorted(candidates, key=lambda one: -self._known[one]):
            if known_only and one not in self._known:
                continue
            if one not in self._decoders:
                self._decoders[one] = new_decoder(*one)
            decoder = self._decoders[one]
            misshapen = int(decoder.form_errors)
            frames = frames_in(decoder, data + b"\0")
            if frames:
                offset = self._offset + self._length - length
                return Decoded(offset, one[1], one[0], frames[0], data), ""
            reason = "form" if decoder.form_errors > misshapen else reason
        return None, reason

    def _refuse(self, length: int, reason: str, data: bytes) -> Refused:
        self.counters[f"refused: {reason}"] += 1
        self.counters["refused bytes"] += length
        return Refused(self._offset, length, reason, data)
