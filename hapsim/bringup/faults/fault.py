"""What every kind of fault shares: the pieces of the wire that it changes, when it happens, and its keys."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Literal, NamedTuple

from pydantic import Field, model_validator

from firmware_protocol import schema
from firmware_protocol.decoder import Frame
from firmware_protocol.frames import frame_to_device, frame_to_host
from hapsim.bringup.capture import Decoded
from hapsim.scene.part import Part
from hapsim.scene.quantity import count, quantity, unexpected

POSITIONS = (schema.POSITION, schema.POSITION_HELD)

Direction = Literal["from_device", "to_device", "both"]

AT = quantity("When it happens, after the first byte", "s", least=0)
FROM = quantity("From when on it happens, after the first byte", "s", least=0)
FOR = quantity("For how long", "s", above=0)
AFTER_SAMPLES = count("When so many samples of the device have passed, in place of a time", 0, 2**31, "samples")
FOR_SAMPLES = count("For so many samples of the device, in place of a time", 1, 2**31, "samples")
PROBABILITY = quantity("Of each frame", "1", least=0, most=1)


def tidy(seconds: float) -> float:
    """Returns a time rounded to the nanosecond, so that what is due in 0.2 s is due once 0.2 s have passed."""
    return round(seconds, 9)


class Moment(NamedTuple):
    """A time, by both of a script's clocks."""

    seconds: float
    """Since the first byte, to the nanosecond (`tidy`)."""
    samples: int
    """Of the device, since its first position; -1 before that."""


class Window:
    """From when, and for how long, a fault is there. It opens once."""

    def __init__(
        self,
        begins_s: float | None = None,
        begins_sample: int | None = None,
        lasts_s: float | None = None,
        lasts_samples: int | None = None,
    ) -> None:
        """Without a beginning it opens with the first byte; without a length it never closes."""
        self.begins_s = tidy(begins_s or 0.0) if begins_sample is None else None
        """s since the first byte; None if it begins at a sample."""
        self.begins_sample = begins_sample
        self.opened: Moment | None = None
        """When it opened."""
        self._lasts_s, self._lasts_samples = lasts_s, lasts_samples

    def is_open(self, now: Moment) -> bool:
        """Opens it if it is time; returns whether the fault is there now."""
        if self.opened is None:
            begun_s = self.begins_s is not None and now.seconds >= self.begins_s
            begun = begun_s or (self.begins_sample is not None and now.samples >= self.begins_sample)
            self.opened = now if begun else None
        return self.opened is not None and not self.is_over(now)

    def is_over(self, now: Moment) -> bool:
        """Returns whether the fault was there, and is no more."""
        if self.opened is None:
            return False
        over_s = self._lasts_s is not None and now.seconds >= tidy(self.opened.seconds + self._lasts_s)
        return over_s or (self._lasts_samples is not None and now.samples >= self.opened.samples + self._lasts_samples)

    def next_s(self, now: Moment) -> float:
        """Returns when time alone opens or closes it, s since the first byte; infinity if it does not."""
        if self.opened is None:
            return math.inf if self.begins_s is None else self.begins_s
        if self._lasts_s is None or self.is_over(now):
            return math.inf
        return tidy(self.opened.seconds + self._lasts_s)


@dataclass(frozen=True)
class Piece:
    """Bytes that pass in one direction, usually a frame with its delimiter."""

    data: bytes
    to_device: bool
    found: Decoded | None = None
    """The frame at their end; None if they are none, or were damaged."""
    delay_s: float = 0.0

    @property
    def frame(self) -> Frame | None:
        """What the frame says."""
        return None if self.found is None else self.found.frame

    def goes(self, direction: Direction) -> bool:
        """Returns whether it goes this way."""
        return direction == "both" or self.to_device == (direction == "to_device")

    def damaged(self, data: bytes) -> Piece:
        """Returns it with other bytes, which are taken for no frame."""
        return replace(self, data=data, found=None)

    def rewritten(self, number: int | None = None, counts: Sequence[int] | None = None) -> Piece:
        """Returns it with other contents in its frame and a valid check; counts saturate at 32 bits.

        Raises:
            ValueError: it has no frame.
        """
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


def at_most_one(given: Mapping[str, object]) -> None:
    """Raises an error (`unexpected`) if both of two keys are given."""
    if None not in given.values():
        unexpected("one of them", found=f"both {' and '.join(given)}")


def exactly_one(given: Mapping[str, object]) -> None:
    """Raises an error (`unexpected`) if both of two keys are given, or neither."""
    at_most_one(given)
    if all(value is None for value in given.values()):
        unexpected("one of them", found=f"neither {' nor '.join(given)}")


class Fault(Part):
    """A fault of a script: its keys, and what it does to a piece. A kind that remembers more has an Effect of its own.

    `hapsim faults --list` prints the docstring of each kind.
    """

    counted: ClassVar[str] = "frames"
    """What is counted of it."""

    kind: str

    def window(self) -> Window:
        """Returns when it happens."""
        return Window()

    def hits(self, piece: Piece, chance: random.Random) -> bool:
        """Returns whether it happens to a piece that passes while it is there."""
        del piece, chance
        return False

    def change(self, piece: Piece, effect: Effect) -> list[Piece]:
        """Returns what passes in place of a piece that it hits; nothing, if a kind does not say otherwise."""
        del piece, effect
        return []

    def effect(self, seed: str) -> Effect:
        """Returns the fault at work; everything random in it comes from `seed`."""
        return Effect(self, seed)

    def when(self) -> str:
        """Returns when it begins, in words."""
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
    """A lasting fault that hits frames at random."""

    direction: Direction = Field(default="both", description="Which way the bytes go that it is about")
    probability: Annotated[float, PROBABILITY] = 1.0

    def hits(self, piece: Piece, chance: random.Random) -> bool:
        return piece.goes(self.direction) and chance.random() < self.probability


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
    """A fault at work: it changes what it hits while its window is open."""

    plugs: bool | None = None
    """Set when the device is plugged in (True) or unplugged (False) by it; the injector resets it."""

    def __init__(self, fault: Fault, seed: str) -> None:
        self.fault, self.window = fault, fault.window()
        self.count = 0
        """How often it happened."""
        # One generator for each direction: the bytes that go one way decide nothing of the other.
        self._chance = {to_device: random.Random(f"{seed} {to_device}") for to_device in (False, True)}

    def chance(self, to_device: bool) -> random.Random:
        """Returns the generator of a direction."""
        return self._chance[to_device]

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Returns what passes in place of a piece."""
        if not self.window.is_open(now) or not self.fault.hits(piece, self._chance[piece.to_device]):
            return [piece]
        self.count += 1
        return self.fault.change(piece, self)

    def pass_time(self, now: Moment) -> list[Piece]:
        """Returns what comes by itself as time passes. Called whenever something passes, and at `next_s`."""
        self.window.is_open(now)
        return []

    def next_s(self, now: Moment) -> float:
        """Returns when `pass_time` has something to do although nothing passes, s since the first byte."""
        return self.window.next_s(now)
