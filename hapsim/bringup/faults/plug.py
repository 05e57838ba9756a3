"""Faults of the plug: silence, a frame that breaks off, a cable that is pulled and put back."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from hapsim.bringup.faults.fault import FOR, FOR_SAMPLES, Direction, Effect, Event, at_most_one, goes
from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.bringup.faults.timing import Window


class _Quiet(Event):
    """What makes the wire silent for a while."""

    direction: Direction = Field(default="from_device", description="Which way nothing passes any more")
    lasts_s: Annotated[float | None, Field(alias="for"), FOR] = None
    for_samples: Annotated[int | None, FOR_SAMPLES] = None

    @model_validator(mode="after")
    def _one_length(self) -> _Quiet:
        at_most_one({"for": self.lasts_s, "for_samples": self.for_samples})
        return self

    def window(self) -> Window:
        return Window(self.at, self.after_samples, self.lasts_s, self.for_samples)


class Silence(_Quiet):
    """Nothing passes."""

    told: ClassVar[str] = "Nothing passes, while the port stays open."
    counted: ClassVar[str] = "frames lost"
    kind: Literal["silence"] = "silence"

    def effect(self, seed: str) -> Effect:
        del seed
        return _Silence(self)


class _Silence(Effect):
    def __init__(self, fault: _Quiet) -> None:
        super().__init__(fault)
        self._direction = fault.direction

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if not goes(piece, self._direction) or not self.window.is_open(now):
            return [piece]
        self.count += 1
        return []


class HalfFrame(_Quiet):
    """A frame breaks off."""

    told: ClassVar[str] = "A frame breaks off in its middle; then nothing passes."
    counted: ClassVar[str] = "frames lost or cut"
    kind: Literal["half_frame"] = "half_frame"

    def effect(self, seed: str) -> Effect:
        del seed
        return _HalfFrame(self)


class _HalfFrame(_Silence):
    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        passing = super().take(piece, now)
        if not passing and self.count == 1:
            return [piece.damaged(piece.data[: len(piece.data) // 2])]
        return passing


class Unplug(Event):
    """The cable is pulled."""

    told: ClassVar[str] = "The port is gone: whoever has it open is hung up."
    counted: ClassVar[str] = "times"
    kind: Literal["unplug"] = "unplug"

    def effect(self, seed: str) -> Effect:
        del seed
        return _Plug(self, False)


class Replug(Event):
    """The cable is put back."""

    told: ClassVar[str] = "The port is there again, under the name of before (--path)."
    counted: ClassVar[str] = "times"
    kind: Literal["replug"] = "replug"

    def effect(self, seed: str) -> Effect:
        del seed
        return _Plug(self, True)


class _Plug(Effect):
    def __init__(self, fault: Event, present: bool) -> None:
        super().__init__(fault)
        self._present = present

    def pass_time(self, now: Moment) -> list[Piece]:
        if self.window.opened is None and self.window.is_open(now):
            self.plugs = self._present
            self.count = 1
        return []
