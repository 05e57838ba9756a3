"""Faults of a wire that loses, damages, repeats, delays or swaps frames. None of them looks into a frame."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, ClassVar, Literal

from hapsim.bringup.faults.fault import NEVER, Effect, FrameEffect, OnFrames
from hapsim.bringup.faults.piece import Moment, Piece, tidy
from hapsim.scene.quantity import Count, Quantity


class Drop(OnFrames):
    """Frames are lost."""

    told: ClassVar[str] = "A frame does not arrive."
    counted: ClassVar[str] = "frames lost"
    kind: Literal["drop"] = "drop"

    def effect(self, seed: str) -> Effect:
        return _Drop(self, seed)


class _Drop(FrameEffect):
    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        return [] if self.hits(piece, now) else [piece]


class Corrupt(OnFrames):
    """Bits flip."""

    told: ClassVar[str] = "Bits of a frame flip, its delimiter's among them."
    counted: ClassVar[str] = "frames damaged"
    kind: Literal["corrupt"] = "corrupt"
    bits: Annotated[int, Count("How many bits of a frame flip", 1, 64)] = 1

    def effect(self, seed: str) -> Effect:
        return _Corrupt(self, seed)


class _Corrupt(FrameEffect):
    def __init__(self, fault: Corrupt, seed: str) -> None:
        super().__init__(fault, seed)
        self._bits = fault.bits

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if not self.hits(piece, now):
            return [piece]
        data, every = bytearray(piece.data), 8 * len(piece.data)
        for bit in self.chance.of(piece).sample(range(every), min(self._bits, every)):
            data[bit // 8] ^= 1 << bit % 8
        return [piece.damaged(bytes(data))]


class Duplicate(OnFrames):
    """Frames come twice."""

    told: ClassVar[str] = "A frame arrives twice."
    counted: ClassVar[str] = "frames sent twice"
    kind: Literal["duplicate"] = "duplicate"

    def effect(self, seed: str) -> Effect:
        return _Duplicate(self, seed)


class _Duplicate(FrameEffect):
    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        return [piece, piece] if self.hits(piece, now) else [piece]


class Delay(OnFrames):
    """Frames come late."""

    told: ClassVar[str] = "A frame arrives late, and so does what is behind it."
    counted: ClassVar[str] = "frames held up"
    kind: Literal["delay"] = "delay"
    seconds: Annotated[float, Quantity("By how much", "s", above=0)]

    def effect(self, seed: str) -> Effect:
        return _Delay(self, seed)


class _Delay(FrameEffect):
    def __init__(self, fault: Delay, seed: str) -> None:
        super().__init__(fault, seed)
        self._seconds = fault.seconds

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        return [replace(piece, delay_s=piece.delay_s + self._seconds)] if self.hits(piece, now) else [piece]


class Reorder(OnFrames):
    """Frames change places."""

    told: ClassVar[str] = "A frame arrives behind the one that was sent after it."
    counted: ClassVar[str] = "frames swapped"
    kind: Literal["reorder"] = "reorder"
    within: Annotated[float, Quantity("For how long the next one is waited for", "s", above=0)] = 0.02

    def effect(self, seed: str) -> Effect:
        return _Reorder(self, seed)


class _Reorder(FrameEffect):
    """Holds at most one piece of each direction, with the time at which it goes on in any case."""

    def __init__(self, fault: Reorder, seed: str) -> None:
        super().__init__(fault, seed)
        self._within = fault.within
        self._held: dict[bool, tuple[Piece, float]] = {}

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if piece.to_device in self._held:
            before, _ = self._held.pop(piece.to_device)
            return [piece, before]
        if self.hits(piece, now):
            self._held[piece.to_device] = piece, tidy(now.seconds + self._within)
            return []
        return [piece]

    def pass_time(self, now: Moment) -> list[Piece]:
        super().pass_time(now)
        over = [way for way, (_, until_s) in self._held.items() if now.seconds >= until_s]
        return [self._held.pop(way)[0] for way in over]

    def next_s(self, now: Moment) -> float:
        return min([super().next_s(now), *(until_s for _, until_s in self._held.values())], default=NEVER)
