"""What every fault of a script has in common: what the file says of it (`Fault`), and what it does (`Effect`)."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from hapsim.bringup.faults.piece import Moment, Piece
from hapsim.bringup.faults.timing import Window
from hapsim.scene.part import Part
from hapsim.scene.quantity import Count, Quantity, unexpected

Direction = Literal["from_device", "to_device", "both"]

AT = Quantity("When it happens, after the first byte", "s", least=0)
FROM = Quantity("From when on it happens, after the first byte", "s", least=0)
FOR = Quantity("For how long", "s", above=0)
AFTER_SAMPLES = Count("When so many samples of the device have passed, in place of a time", 0, 2**31, "samples")
FOR_SAMPLES = Count("For so many samples of the device, in place of a time", 1, 2**31, "samples")
PROBABILITY = Quantity("Of each frame", "1", least=0, most=1)


def at_most_one(said: Mapping[str, object]) -> None:
    """An error through `unexpected` where both of two keys say something."""
    if None not in said.values():
        unexpected("one of them", found=f"both {' and '.join(said)}")


def exactly_one(said: Mapping[str, object]) -> None:
    """An error through `unexpected` where both of two keys say something, or neither."""
    at_most_one(said)
    if all(value is None for value in said.values()):
        unexpected("one of them", found=f"neither {' nor '.join(said)}")


class Fault(Part):
    """A fault of a script. A kind is a class with its own fields, its `effect`, and a sentence for the list of them."""

    told: ClassVar[str]
    """What it does, in a sentence."""
    counted: ClassVar[str] = "frames"
    """What is counted of it."""

    kind: str

    def effect(self, seed: str) -> Effect:
        """The fault, ready to happen; everything that it leaves to chance comes from `seed`."""
        raise NotImplementedError

    def window(self) -> Window:
        """When it happens."""
        return Window()

    def when(self) -> str:
        """The same in words."""
        window = self.window()
        if window.begins_sample is not None:
            return f"after {window.begins_sample} samples"
        return f"at {window.begins_s:g} s" if window.begins_s else "from the first byte"


class Lasting(Fault):
    """A fault that is there for a while."""

    begins_s: Annotated[float | None, Field(alias="from"), FROM] = None
    lasts_s: Annotated[float | None, Field(alias="for"), FOR] = None
    after_samples: Annotated[int | None, AFTER_SAMPLES] = None
    for_samples: Annotated[int | None, FOR_SAMPLES] = None

    @model_validator(mode="after")
    def _one_clock(self) -> Lasting:
        at_most_one({"from": self.begins_s, "after_samples": self.after_samples})
        at_most_one({"for": self.lasts_s, "for_samples": self.for_samples})
        return self

    def window(self) -> Window:
        return Window(self.begins_s, self.after_samples, self.lasts_s, self.for_samples)


class OnFrames(Lasting):
    """A lasting fault that hits frames by chance."""

    direction: Direction = Field(default="both", description="Which way the bytes go that it is about")
    probability: Annotated[float, PROBABILITY] = 1.0


class Event(Fault):
    """A fault that happens once."""

    at: Annotated[float | None, AT] = None
    after_samples: Annotated[int | None, AFTER_SAMPLES] = None

    @model_validator(mode="after")
    def _one_clock(self) -> Event:
        exactly_one({"at (s)": self.at, "after_samples": self.after_samples})
        return self

    def window(self) -> Window:
        return Window(self.at, self.after_samples)


class Effect:
    """A fault at work. This one lets everything pass."""

    plugs: bool | None = None
    """Once it happened: whether the device is plugged in; None: it has nothing to do with that."""

    def __init__(self, fault: Fault) -> None:
        self.window = fault.window()
        self.count = 0
        """How often it happened."""

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """What becomes of a piece that passes."""
        del now
        return [piece]

    def pass_time(self, now: Moment) -> list[Piece]:
        """What comes of itself as time passes. Called at every moment at which something passes, and at `next_s`."""
        self.window.is_open(now)
        return []

    def next_s(self, now: Moment) -> float:
        """When `pass_time` has something to do although nothing passes, s since the first byte."""
        return self.window.next_s(now)


class Chance:
    """What is left to chance, for each direction by itself: the bytes that go one way decide nothing of the other."""

    def __init__(self, seed: str) -> None:
        self._generators = {to_device: random.Random(f"{seed} {to_device}") for to_device in (False, True)}

    def of(self, piece: Piece) -> random.Random:
        """The generator of the piece's direction."""
        return self._generators[piece.to_device]


class FrameEffect(Effect):
    """A fault that hits frames of its direction by chance, while its window is open."""

    def __init__(self, fault: OnFrames, seed: str) -> None:
        super().__init__(fault)
        self._fault, self.chance = fault, Chance(seed)

    def hits(self, piece: Piece, now: Moment) -> bool:
        """Whether it happens to this piece; then it is counted."""
        if not self.window.is_open(now) or not goes(piece, self._fault.direction):
            return False
        hit = self.chance.of(piece).random() < self._fault.probability
        self.count += hit
        return hit


def goes(piece: Piece, direction: Direction) -> bool:
    """Whether a piece goes this way."""
    return direction == "both" or piece.to_device == (direction == "to_device")


NEVER = math.inf
