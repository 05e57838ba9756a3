"""What passes on the wire, piece by piece: the bytes up to a delimiter, and the frame that they are, if any."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from firmware_protocol import schema
from firmware_protocol.frames import frame_to_device, frame_to_host
from hapsim.bringup.capture import Capture, Decoded

LONGEST = 512
"""Bytes that are waited for without a delimiter among them, far more than a frame has: then they pass as they are."""


def tidy(seconds: float) -> float:
    """A time to the nanosecond, so that what is due in 0.2 s is due once 0.2 s have passed, on whatever clock."""
    return round(seconds, 9)


class Moment(NamedTuple):
    """When something happens, by both of a script's clocks."""

    seconds: float
    """Since the first byte, to the nanosecond (`tidy`)."""
    samples: int
    """Of the device, since its first position; -1 before that."""


@dataclass(frozen=True)
class Piece:
    """Bytes that pass in one direction, as a rule a frame with its delimiter."""

    data: bytes
    to_device: bool
    found: Decoded | None = None
    """The frame at the end of them; None where they are none, or were damaged on the way here."""
    delay_s: float = 0.0
    """For how long they are held up."""

    def damaged(self, data: bytes) -> Piece:
        """With other bytes, of which nobody knows what they are."""
        return replace(self, data=data, found=None)

    def rewritten(self, number: int | None = None, counts: Sequence[int] | None = None) -> Piece:
        """With other contents in its frame, and a right check; counts are cut to 32 bits. It has to have a frame."""
        found = self.found
        if found is None:
            raise ValueError("nothing to rewrite: these bytes are no frame")
        frame = found.frame
        number = frame.number if number is None else number % schema.SAMPLE_MODULUS
        words = [min(max(count, -(2**31)), 2**31 - 1) for count in (frame.counts if counts is None else counts)]
        if self.to_device:
            data = frame_to_device(found.wire, frame.type, number, frame.argument, words)
        else:
            data = frame_to_host(found.wire, frame.type, number, words)
        in_front = self.data[: len(self.data) - len(found.data) - 1]
        other = found._replace(frame=frame._replace(number=number, counts=tuple(words)), data=data[:-1])
        return replace(self, data=in_front + data, found=other)


class Splitter:
    """Cuts the bytes of one direction into pieces, however they arrive: the same bytes make the same pieces."""

    def __init__(self, to_device: bool) -> None:
        self.capture = Capture((to_device,))
        """What was read of them, registers among it."""
        self._to_device = to_device
        self._waiting = b""

    def split(self, data: bytes) -> Iterator[Piece]:
        """Every piece that ends in `data`. What is left waits for its delimiter."""
        self._waiting += data
        while self._waiting:
            end = self._waiting.find(0) + 1
            if end == 0 or end > LONGEST:
                if len(self._waiting) < LONGEST:
                    return
                end = LONGEST
            stretch, self._waiting = self._waiting[:end], self._waiting[end:]
            yield Piece(stretch, self._to_device, self._frame_at_the_end(stretch))

    def _frame_at_the_end(self, stretch: bytes) -> Decoded | None:
        last = None
        for found in self.capture.feed(stretch):
            last = found
        whole = isinstance(last, Decoded) and len(last.data) < len(stretch)
        return last if whole and isinstance(last, Decoded) else None
