"""A device whose timer is wrong: it samples at another rate than it says, and counts its own samples."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from firmware_protocol import schema
from hapsim.bringup.faults.fault import Effect, Lasting
from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.scene.quantity import Quantity

_MOVING = (schema.POSITION, schema.POSITION_HELD)
_MODULUS = schema.SAMPLE_MODULUS


class Rate(Lasting):
    """The device samples at another rate than it declares."""

    told: ClassVar[str] = "The device samples at a factor of the rate that it declares."
    counted: ClassVar[str] = "positions left out or repeated"
    kind: Literal["rate"] = "rate"
    factor: Annotated[float, Quantity("The rate over the declared one", "1", least=0.01, most=10)]

    def effect(self, seed: str) -> Effect:
        del seed
        return _Rate(self)


class _Rate(Effect):
    """Of the device's samples it passes on a share, or repeats some, and numbers what the host sees one by one. A force
    then names the sample that the device knows."""

    def __init__(self, fault: Rate) -> None:
        super().__init__(fault)
        self._factor = fault.factor
        self._due = 0.0  # samples that the host is to see, and has not seen
        self._seen: int | None = None  # the number of the last one that it saw
        self._true = [0] * _MODULUS  # the device's number of each that it saw

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if piece.found is None:
            return [piece]
        frame = piece.found.frame
        if frame.type == schema.STATUS and not piece.to_device:
            self._seen, self._due = None, 0.0  # armed anew, or over: it counts from 0
        if piece.to_device and frame.type == schema.FORCE and self._seen is not None:
            return [piece.rewritten(number=self._true[frame.number])]
        if piece.to_device or frame.type not in _MOVING:
            return [piece]
        if not self.window.is_open(now) and self._seen is None:
            self._true[frame.number] = frame.number
            return [piece]
        return self._positions(piece, frame.number, self.window.is_open(now))

    def _positions(self, piece: Piece, number: int, wrong: bool) -> list[Piece]:
        if self._seen is None:
            self._seen = number - 1
        self._due += self._factor if wrong else 1.0
        passed = []
        while self._due >= 1.0:
            self._due -= 1.0
            self._seen = (self._seen + 1) % _MODULUS
            self._true[self._seen] = number
            passed.append(piece.rewritten(number=self._seen))
        self.count += len(passed) != 1
        return passed
