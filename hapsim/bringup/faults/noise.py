"""Faults that put bytes of nobody on the wire: noise, and bytes that were read at another rate than they were sent."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from hapsim.bringup.faults.fault import Chance, Direction, Effect, FrameEffect, Lasting, OnFrames, at_most_one
from hapsim.bringup.faults.piece import Moment, Piece, tidy
from hapsim.scene.quantity import Count, Quantity


class Garbage(Lasting):
    """Noise between two frames."""

    told: ClassVar[str] = "Bytes that nobody sent arrive between two frames."
    counted: ClassVar[str] = "bursts of bytes"
    kind: Literal["garbage"] = "garbage"
    direction: Direction = Field(default="from_device", description="Which way they go")
    bytes: Annotated[int, Count("How many at a time", 1, 100_000)]
    every: Annotated[float | None, Quantity("How often they come", "s", above=0, left_out="once")] = None
    every_samples: Annotated[int | None, Count("How often they come, in place of a time", 1, 2**31, "samples")] = None

    @model_validator(mode="after")
    def _one_period(self) -> Garbage:
        at_most_one({"every": self.every, "every_samples": self.every_samples})
        return self

    def effect(self, seed: str) -> Effect:
        return _Garbage(self, seed)


class _Garbage(Effect):
    def __init__(self, fault: Garbage, seed: str) -> None:
        super().__init__(fault)
        self._fault, self._chance = fault, Chance(seed)
        self._due: Moment | None = None  # the next time, by either clock

    def pass_time(self, now: Moment) -> list[Piece]:
        if not self.window.is_open(now):
            return []
        due = self._due or now
        if now.seconds < due.seconds or now.samples < due.samples:
            return []
        every_s = math.inf if self._fault.every is None else self._fault.every
        every = self._fault.every_samples
        self._due = Moment(tidy(due.seconds + every_s), -1) if every is None else Moment(0.0, due.samples + every)
        self.count += 1
        ways = [
            way for way in (False, True) if self._fault.direction in ("both", "to_device" if way else "from_device")
        ]
        return [self._noise(way) for way in ways]

    def next_s(self, now: Moment) -> float:
        if self._due is None or self.window.opened is None:
            return self.window.next_s(now)
        if self.window.is_over(now) or self._fault.every_samples is not None:
            return math.inf
        return self._due.seconds

    def _noise(self, to_device: bool) -> Piece:
        silent = Piece(b"", to_device)
        return silent.damaged(self._chance.of(silent).randbytes(self._fault.bytes))


class WrongBaud(OnFrames):
    """The receiver samples bits at another rate."""

    told: ClassVar[str] = "Bytes arrive as a UART reads them that is set to another rate."
    counted: ClassVar[str] = "frames garbled"
    kind: Literal["wrong_baud"] = "wrong_baud"
    ratio: Annotated[float, Quantity("The receiver's bit rate over the sender's", "1", least=0.05, most=20)] = 0.5

    def effect(self, seed: str) -> Effect:
        return _WrongBaud(self, seed)


class _WrongBaud(FrameEffect):
    def __init__(self, fault: WrongBaud, seed: str) -> None:
        super().__init__(fault, seed)
        self._ratio = fault.ratio

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        return [piece.damaged(misread(piece.data, self._ratio))] if self.hits(piece, now) else [piece]


def misread(data: bytes, ratio: float) -> bytes:
    """What a UART reads of bytes that were sent one after the other at 1/`ratio` of its own bit rate.

    A byte is a start bit (0), eight data bits, the lowest first, and a stop bit (1); before and after the bytes the
    wire rests at 1. The receiver waits for a falling edge, takes each bit in its middle by its own clock, passes the
    byte on whatever the stop bit is (as a terminal without INPCK does), and waits for the wire to be at 1 and fall.
    """
    levels = [bit for byte in data for bit in (0, *(byte >> k & 1 for k in range(8)), 1)]
    step = 1.0 / ratio  # of the receiver, in bits of the sender

    def level(at: float) -> int:
        return levels[int(at)] if at < len(levels) else 1

    read, at = bytearray(), 0.0
    while (edge := _falling_edge(levels, at)) is not None:
        byte = sum(level(edge + (k + 1.5) * step) << k for k in range(8))
        read.append(byte)
        at = edge + 9.5 * step  # the middle of the stop bit
    return bytes(read)


def _falling_edge(levels: list[int], after: float) -> int | None:
    """Where the wire next falls from 1 to 0, in bits; it was at 1 before the first."""
    for at in range(math.ceil(after), len(levels)):
        if levels[at] == 0 and (at == 0 or levels[at - 1] == 1):
            return at
    return None
