"""Faults of a device that says something else of itself than it is: another version, scales that are no numbers."""

from __future__ import annotations

import math
import struct
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from firmware_protocol import schema
from hapsim.bringup.faults.fault import Effect, Fault, Lasting
from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.scene.quantity import Count, unexpected

_WHOLE = {
    "channels": schema.REG_CHANNELS,
    "pacings": schema.REG_PACINGS,
    "max_watchdog": schema.REG_MAX_WATCHDOG,
    "schema": schema.REG_SCHEMA,
}
_OF_CHANNEL = {
    "position_scale": schema.REG_POSITION_SCALE,
    "force_scale": schema.REG_FORCE_SCALE,
    "force_limit": schema.REG_FORCE_LIMIT,
    "velocity_scale": schema.REG_VELOCITY_SCALE,
}
_REALS = {"nan": math.nan, "zero": 0.0, "negative": -1.0, "huge": 1e300}
_INTEGERS = {"zero": 0, "negative": -1, "huge": 2**31 - 1}


class Version(Lasting):
    """The device speaks another version."""

    told: ClassVar[str] = "The device says that it speaks another version of the protocol."
    counted: ClassVar[str] = "answers changed"
    kind: Literal["version"] = "version"
    answers: Annotated[int, Count("The version that it says it speaks", 0, 2**31 - 1)] = 2

    def effect(self, seed: str) -> Effect:
        del seed
        return _Answers(self, {schema.REG_VERSION: self.answers})


class Nonsense(Lasting):
    """The device describes itself by numbers that nothing has."""

    told: ClassVar[str] = "The device declares a rate, a scale, a limit or a number that cannot be."
    counted: ClassVar[str] = "answers changed"
    kind: Literal["nonsense"] = "nonsense"
    register_: Literal[
        "rate",
        "position_scale",
        "force_scale",
        "force_limit",
        "velocity_scale",
        "channels",
        "pacings",
        "max_watchdog",
        "schema",
    ] = Field(alias="register", description="What it says it of, by its name in PROTOCOL.md, section 5")
    what: Literal["nan", "zero", "negative", "huge"] = Field(description="And what it says")

    @model_validator(mode="after")
    def _fits(self) -> Nonsense:
        if self.register_ in _WHOLE and self.what not in _INTEGERS:
            unexpected(
                f"zero, negative or huge of {self.register_}: it is a whole number, and none of them is nan",
                found=self.what,
            )
        return self

    def effect(self, seed: str) -> Effect:
        del seed
        return _Answers(self, self._words())

    def _words(self) -> dict[int, int]:
        """What is answered in place of the truth, signed, by register."""
        if self.register_ in _WHOLE:
            return {_WHOLE[self.register_]: _INTEGERS[self.what]}
        low, high = struct.unpack("<ii", struct.pack("<d", _REALS[self.what]))
        if self.register_ == "rate":
            return {schema.REG_RATE: low, schema.REG_RATE + 1: high}
        first = [
            schema.REG_CHANNEL + channel * schema.CHANNEL_WORDS + _OF_CHANNEL[self.register_]
            for channel in range(schema.MAX_CHANNELS)
        ]
        return {at + k: word for at in first for k, word in enumerate((low, high))}


class _Answers(Effect):
    """Other answers to DESCRIBE."""

    def __init__(self, fault: Fault, words: dict[int, int]) -> None:
        super().__init__(fault)
        self._words = words

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        frame = piece.found.frame if piece.found is not None and not piece.to_device else None
        if frame is None or frame.type != schema.DESCRIPTION or frame.number not in self._words:
            return [piece]
        if not self.window.is_open(now):
            return [piece]
        self.count += 1
        return [piece.rewritten(counts=[self._words[frame.number]])]
