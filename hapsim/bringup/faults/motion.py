"""Faults of a sensor or of a motor's sign: positions that leap, positions or forces the other way round."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from firmware_protocol import schema
from hapsim.bringup.capture import Capture
from hapsim.bringup.faults.fault import Effect, Event, exactly_one
from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.scene.quantity import Count, Quantity

_MOVING = (schema.POSITION, schema.POSITION_HELD)


class Leap(Event):
    """The position jumps, and stays where it jumped to."""

    told: ClassVar[str] = "The positions are elsewhere from one sample to the next, and go on from there."
    counted: ClassVar[str] = "positions moved"
    kind: Literal["leap"] = "leap"
    metres: Annotated[float | None, Quantity("How far", "m", left_out="counts says it")] = None
    counts: Annotated[int | None, Count("How far, in place of metres", -(2**31), 2**31 - 1, "counts")] = None
    channel: Annotated[int, Count("Of which channel", 0, schema.MAX_CHANNELS - 1)] = 0

    @model_validator(mode="after")
    def _one_length(self) -> Leap:
        exactly_one({"metres": self.metres, "counts": self.counts})
        return self

    def effect(self, seed: str) -> Effect:
        del seed
        return _Leap(self)


class _Leap(Effect):
    """Where only metres are given, the scale is the one that the device described."""

    def __init__(self, fault: Leap) -> None:
        super().__init__(fault)
        self._fault, self._described = fault, Capture((False,))

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if piece.to_device or piece.found is None:
            return [piece]
        frame, channel = piece.found.frame, self._fault.channel
        if frame.type == schema.DESCRIPTION:
            self._described.registers[frame.number] = frame.counts[0] & 0xFFFFFFFF
        if frame.type not in _MOVING or channel >= piece.found.wire.channels or not self.window.is_open(now):
            return [piece]
        by = self._counts()
        if by is None:
            return [piece]
        self.count += 1
        counts = list(frame.counts)
        counts[channel] += by
        return [piece.rewritten(counts=counts)]

    def _counts(self) -> int | None:
        """How far, in counts; None where the device did not say how long one is."""
        if self._fault.counts is not None or self._fault.metres is None:
            return self._fault.counts
        scale = self._described.scale(schema.REG_POSITION_SCALE, self._fault.channel)
        return round(self._fault.metres / scale) if scale else None


class Invert(Event):
    """A sign is wrong from now on."""

    told: ClassVar[str] = "Positions (from_device) or forces (to_device) have the other sign from then on."
    counted: ClassVar[str] = "frames inverted"
    kind: Literal["invert"] = "invert"
    direction: Literal["from_device", "to_device"] = Field(
        default="from_device", description="from_device: positions and velocities; to_device: forces"
    )

    def effect(self, seed: str) -> Effect:
        del seed
        return _Invert(self)


class _Invert(Effect):
    def __init__(self, fault: Invert) -> None:
        super().__init__(fault)
        self._to_device = fault.direction == "to_device"

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        inverted = (schema.FORCE,) if self._to_device else _MOVING
        if piece.to_device != self._to_device or piece.found is None or piece.found.frame.type not in inverted:
            return [piece]
        if not self.window.is_open(now):
            return [piece]
        self.count += 1
        return [piece.rewritten(counts=[-count for count in piece.found.frame.counts])]
