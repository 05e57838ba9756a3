"""Faults of the wire: frames lost, damaged, repeated, late or swapped; noise; a plug. None looks into a frame."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Annotated, ClassVar, Literal

from pydantic import Field, PrivateAttr, model_validator

from hapsim.bringup.faults.fault import (
    Direction,
    Event,
    For,
    ForSamples,
    Lasting,
    Moment,
    OnFrames,
    Piece,
    Window,
    require_one,
    tidy,
)
from hapsim.scene.quantity import count, quantity


class Drop(OnFrames):
    """A frame does not arrive."""

    counted: ClassVar[str] = "frames lost"
    kind: Literal["drop"] = "drop"


class Corrupt(OnFrames):
    """Bits of a frame flip, its delimiter's among them."""

    counted: ClassVar[str] = "frames damaged"
    kind: Literal["corrupt"] = "corrupt"
    bits: Annotated[int, count("How many bits of a frame flip", 1, 64)] = 1

    def change(self, piece: Piece) -> list[Piece]:
        data, every = bytearray(piece.data), 8 * len(piece.data)
        for bit in self._chance[piece.to_device].sample(range(every), min(self.bits, every)):
            data[bit // 8] ^= 1 << bit % 8
        return [piece.damaged(bytes(data))]


class Duplicate(OnFrames):
    """A frame arrives twice."""

    counted: ClassVar[str] = "frames sent twice"
    kind: Literal["duplicate"] = "duplicate"

    def change(self, piece: Piece) -> list[Piece]:
        return [piece, piece]


class Delay(OnFrames):
    """A frame arrives late, and so does what is behind it."""

    counted: ClassVar[str] = "frames delayed"
    kind: Literal["delay"] = "delay"
    seconds: Annotated[float, quantity("By how much", "s", above=0)]

    def change(self, piece: Piece) -> list[Piece]:
        return [replace(piece, delay_s=piece.delay_s + self.seconds)]


class Reorder(OnFrames):
    """A frame arrives behind the one that was sent after it."""

    counted: ClassVar[str] = "frames swapped"
    kind: Literal["reorder"] = "reorder"
    within: Annotated[float, quantity("How long it waits for the next one", "s", above=0)] = 0.02

    # A piece of each direction, at most, and when it is sent in any case.
    _kept: dict[bool, tuple[Piece, float]] = PrivateAttr(default_factory=dict)

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Keeps a piece back; the next one in its direction passes in front of it."""
        if piece.to_device in self._kept:
            return [piece, self._kept.pop(piece.to_device)[0]]
        passing = super().take(piece, now)
        if not passing:
            self._kept[piece.to_device] = piece, tidy(now.seconds + self.within)
        return passing

    def pass_time(self, now: Moment) -> list[Piece]:
        """Returns the pieces that waited for `within` seconds."""
        super().pass_time(now)
        over = [way for way, (_, until_s) in self._kept.items() if now.seconds >= until_s]
        return [self._kept.pop(way)[0] for way in over]

    def next_s(self, now: Moment) -> float:
        return min([super().next_s(now), *(until_s for _, until_s in self._kept.values())])


class Garbage(Lasting):
    """Bytes that the device did not send arrive between two frames."""

    counted: ClassVar[str] = "bursts of bytes"
    kind: Literal["garbage"] = "garbage"
    direction: Direction = Field(default="from_device", description="The direction of these bytes")
    bytes: Annotated[int, count("How many at a time", 1, 100_000)]
    every: Annotated[float | None, quantity("How often they come", "s", above=0, left_out="once")] = None
    every_samples: Annotated[int | None, count("How often they come, in place of a time", 1, 2**31, "samples")] = None

    _due: Moment | None = None  # the next time

    @model_validator(mode="after")
    def _one_period(self) -> Garbage:
        require_one(every=self.every, every_samples=self.every_samples)
        return self

    def pass_time(self, now: Moment) -> list[Piece]:
        """Returns a burst of random bytes, if one is due."""
        due = self._due or now
        if not self._window.is_open(now) or not now.has_reached(due):
            return []
        self._due = due.after(self.every, self.every_samples)
        self._count += 1
        silent = [piece for piece in (Piece(b"", False), Piece(b"", True)) if piece.goes(self.direction)]
        return [piece.damaged(self._chance[piece.to_device].randbytes(self.bytes)) for piece in silent]

    def next_s(self, now: Moment) -> float:
        if self._due is None:
            return self._window.next_s(now)
        return math.inf if self._window.is_over(now) else self._due.seconds


class WrongBaud(OnFrames):
    """Bytes arrive as a UART reads them that is set to another rate."""

    counted: ClassVar[str] = "frames garbled"
    kind: Literal["wrong_baud"] = "wrong_baud"
    ratio: Annotated[float, quantity("The receiver's bit rate over the sender's", "1", least=0.05, most=20)] = 0.5

    def change(self, piece: Piece) -> list[Piece]:
        return [piece.damaged(misread(piece.data, self.ratio))]


def misread(data: bytes, ratio: float) -> bytes:
    """Returns what a UART reads of bytes that were sent one after the other at 1/`ratio` of its own bit rate.

    A byte is a start bit (0), eight data bits, the lowest first, and a stop bit (1); before and after the bytes the
    wire rests at 1. The receiver waits for a falling edge, samples each bit in its middle by its own clock, and passes
    the byte on whatever the stop bit is (as a terminal without INPCK does).
    """
    levels = [1, *(bit for byte in data for bit in (0, *(byte >> k & 1 for k in range(8)), 1))]
    falls = [at for at in range(1, len(levels)) if levels[at] < levels[at - 1]]
    step = 1.0 / ratio  # of the receiver, in bits of the sender
    read, after = bytearray(), 0.0
    for edge in falls:
        if edge >= after:
            samples = [int(edge + (k + 1.5) * step) for k in range(8)]
            read.append(sum((levels[at] if at < len(levels) else 1) << k for k, at in enumerate(samples)))
            after = edge + 9.5 * step  # the middle of the stop bit
    return bytes(read)


class Silence(Event):
    """Nothing passes, while the port stays open."""

    counted: ClassVar[str] = "frames lost"
    kind: Literal["silence"] = "silence"
    direction: Direction = Field(default="from_device", description="The direction in which nothing passes")
    lasts_s: For = None
    for_samples: ForSamples = None

    @model_validator(mode="after")
    def _one_length(self) -> Silence:
        require_one(for_=self.lasts_s, for_samples=self.for_samples)
        return self

    def window(self) -> Window:
        return Window(self.at_s, self.after_samples, self.lasts_s, self.for_samples)

    def hits(self, piece: Piece) -> bool:
        return piece.goes(self.direction)


class HalfFrame(Silence):
    """A frame breaks off in its middle; then nothing passes."""

    counted: ClassVar[str] = "frames lost or cut"
    kind: Literal["half_frame"] = "half_frame"  # type: ignore[assignment]

    def change(self, piece: Piece) -> list[Piece]:
        return [piece.damaged(piece.data[: len(piece.data) // 2])] if self.count == 1 else []


class Unplug(Event):
    """The port disappears: a program that has it open is hung up."""

    counted: ClassVar[str] = "times"
    plugs: ClassVar[bool | None] = False
    kind: Literal["unplug"] = "unplug"

    def pass_time(self, now: Moment) -> list[Piece]:
        self._happens_once(now)
        return []


class Replug(Unplug):
    """The port is there again, under the name of before (--path)."""

    plugs: ClassVar[bool | None] = True
    kind: Literal["replug"] = "replug"  # type: ignore[assignment]


WireFault = Drop | Corrupt | Duplicate | Delay | Reorder | Garbage | WrongBaud | HalfFrame | Silence | Unplug | Replug
