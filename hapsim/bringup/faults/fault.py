"""Base classes of faults: pieces of the byte stream, times, and the keys that all kinds share."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Container, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

from pydantic import Field, model_validator

from firmware_protocol import schema
from firmware_protocol.capture import Decoded
from firmware_protocol.decoder import Frame
from firmware_protocol.frames import frame_to_device, frame_to_host
from hapsim.scene.quantity import count, quantity
from hapsim.scene.schemas import unexpected
from hapsim.scene.section import Section

Direction = Literal["from_device", "to_device", "both"]

# The keys that say when a fault happens, and for how long.
At = Annotated[float | None, Field(alias="at"), quantity("When it happens, after the first byte", "s", least=0)]
From = Annotated[float | None, Field(alias="from"), quantity("When it begins, after the first byte", "s", least=0)]
For = Annotated[float | None, Field(alias="for"), quantity("For how long", "s", above=0)]
AfterSamples = Annotated[int | None, count("After this many samples, in place of a time", 0, 2**31, "samples")]
ForSamples = Annotated[int | None, count("For this many samples, in place of a time", 1, 2**31, "samples")]
Probability = Annotated[float, quantity("Of each frame", "1", least=0, most=1)]


def tidy(seconds: float) -> float:
    """Returns a time rounded to the nanosecond, so that what is due in 0.2 s is due once 0.2 s have passed."""
    return round(seconds, 9)


class Moment(NamedTuple):
    """A time by both of a script's clocks; infinity if one of them does not matter."""

    seconds: float
    """Since the first byte, to the nanosecond (`tidy`)."""
    samples: float
    """Samples of the device since its first position; -1 before that."""

    def has_reached(self, due: Moment) -> bool:
        """Returns whether either clock is at `due` or later."""
        return self.seconds >= due.seconds or self.samples >= due.samples

    def after(self, seconds: float | None, samples: int | None) -> Moment:
        """Returns the moment after a length, by the clock for which there is one."""
        return Moment(
            math.inf if seconds is None else tidy(self.seconds + seconds),
            math.inf if samples is None else self.samples + samples,
        )


class Window:
    """Start and duration of a fault. A window opens once."""

    def __init__(
        self, at_s: float | None, at_sample: int | None, lasts_s: float | None = None, lasts_samples: int | None = None
    ) -> None:
        """Opens with the first byte if no start is given, and never closes if no duration is given."""
        self.begins = Moment(0.0, 0).after(0.0 if at_s is None and at_sample is None else at_s, at_sample)
        self.opened: Moment | None = None
        """Time of opening."""
        self._lasts_s, self._lasts_samples = lasts_s, lasts_samples

    def is_open(self, now: Moment) -> bool:
        """Opens it if it is time; returns whether the fault acts now."""
        if self.opened is None and now.has_reached(self.begins):
            self.opened = now
        return self.opened is not None and not self.is_over(now)

    def is_over(self, now: Moment) -> bool:
        """Returns whether the fault has ended."""
        return self.opened is not None and now.has_reached(self.opened.after(self._lasts_s, self._lasts_samples))

    def next_s(self, now: Moment) -> float:
        """Returns when time alone opens or closes it, s since the first byte; infinity if it does not."""
        if self.opened is None:
            return self.begins.seconds
        return math.inf if self.is_over(now) else self.opened.after(self._lasts_s, None).seconds


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
        """Decoded frame, if the piece is one."""
        return None if self.found is None else self.found.frame

    def goes(self, direction: Direction) -> bool:
        """Returns whether it goes this way."""
        return direction == "both" or self.to_device == (direction == "to_device")

    def is_from_device(self, *types: int, numbers: Container[int] = range(schema.SAMPLE_MODULUS)) -> bool:
        """Returns whether it is a frame of the device of one of these types, with one of these numbers."""
        frame = None if self.to_device else self.frame
        return frame is not None and frame.type in types and frame.number in numbers

    def damaged(self, data: bytes) -> Piece:
        """Returns it with other bytes, which are taken for no frame."""
        return replace(self, data=data, found=None)

    def rewritten(
        self, number: int | None = None, counts_of: Callable[[Frame], Sequence[int]] = lambda frame: frame.counts
    ) -> Piece:
        """Returns it with other contents in its frame and a valid check; counts saturate at 32 bits."""
        found = self.found
        assert found is not None, "these bytes are no frame"
        frame = found.frame
        number = frame.number if number is None else number % schema.SAMPLE_MODULUS
        words = [min(max(count, -(2**31)), 2**31 - 1) for count in counts_of(frame)]
        if self.to_device:
            data = frame_to_device(found.wire, frame.type, number, frame.argument, words)
        else:
            data = frame_to_host(found.wire, frame.type, number, words)
        in_front = self.data[: len(self.data) - len(found.data) - 1]
        other = found._replace(frame=frame._replace(number=number, counts=tuple(words)), data=data[:-1])
        return replace(self, data=in_front + data, found=other)


def one_of(*names: str, required: bool = False) -> Any:
    """Returns a validator of a fault: several of these fields, or none of `required` ones, are an error (`unexpected`),
    which names their keys."""

    def check(fault: Section) -> Section:
        """Returns the fault. Raises for too many or too few of the fields."""
        keys = [type(fault).model_fields[name].alias or name for name in names]
        count = sum(getattr(fault, name) is not None for name in names)
        if count > 1:
            unexpected("one of them", found=f"both {' and '.join(keys)}")
        if required and count == 0:
            unexpected("one of them", found=f"neither {' nor '.join(keys)}")
        return fault

    return model_validator(mode="after")(check)


KINDS: dict[str, type[Fault]] = {}
"""The class of each `kind`, in the order in which they are defined."""


class Fault(Section):
    """A fault of a script: its keys, and what it does to the pieces that pass. A copy of it is at work in an injector.

    `hapsim faults --list` prints the docstring of each kind.
    """

    counted: ClassVar[str] = "frames"
    """Unit of `count`."""
    plugs: ClassVar[bool | None] = None
    """State of the plug after the fault: True plugged in, False unplugged, None unchanged."""

    kind: str
    """Kind of fault; its default is the name in a script. An abstract fault has no default."""

    _window: Window
    _count: int = 0
    _chance: dict[bool, random.Random]

    @classmethod
    def __pydantic_init_subclass__(cls, **_: object) -> None:
        if isinstance(kind := cls.model_fields["kind"].default, str):
            KINDS[kind] = cls

    def model_post_init(self, _context: object) -> None:
        self._window = self.window()

    def at_work(self, seed: str) -> Self:
        """Returns a copy that acts; everything random in it comes from `seed`."""
        copy = self.model_copy(deep=True)
        # One generator for each direction: the bytes that go one way decide nothing of the other.
        copy._chance = {to_device: random.Random(f"{seed} {to_device}") for to_device in (False, True)}
        return copy

    @property
    def count(self) -> int:
        """Number of times that the fault acted."""
        return self._count

    def window(self) -> Window:
        """Returns when it happens."""
        raise NotImplementedError

    def hits(self, _piece: Piece) -> bool:
        """Returns whether it happens to a piece that passes while its window is open."""
        return False

    def change(self, _piece: Piece) -> list[Piece]:
        """Returns what passes in place of a piece that it hits."""
        return []

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Returns what passes in place of a piece."""
        if not self._window.is_open(now) or not self.hits(piece):
            return [piece]
        self._count += 1
        return self.change(piece)

    def pass_time(self, now: Moment) -> list[Piece]:
        """Returns what comes by itself as time passes. Called whenever something passes, and at `next_s`."""
        self._window.is_open(now)
        return []

    def next_s(self, now: Moment) -> float:
        """Returns when `pass_time` has something to do although nothing passes, s since the first byte."""
        return self._window.next_s(now)

    def _happens_once(self, now: Moment) -> bool:
        """Counts it, and returns True, once: when its window opens."""
        happens = self._count == 0 and self._window.is_open(now)
        self._count += happens
        return happens

    def when(self) -> str:
        """Returns when it begins, in words."""
        begins = self._window.begins
        if begins.samples < math.inf:
            return f"after {begins.samples} samples"
        return f"at {begins.seconds:g} s" if begins.seconds else "from the first byte"


class Lasting(Fault):
    """A fault that acts for a while."""

    begins_s: From = None
    lasts_s: For = None
    after_samples: AfterSamples = None
    for_samples: ForSamples = None

    _one_begin = one_of("begins_s", "after_samples")
    _one_length = one_of("lasts_s", "for_samples")

    def window(self) -> Window:
        return Window(self.begins_s, self.after_samples, self.lasts_s, self.for_samples)


class OnFrames(Lasting):
    """A lasting fault that hits frames at random."""

    direction: Direction = Field(default="both", description="The direction of the frames that it hits")
    probability: Probability = 1.0

    def hits(self, piece: Piece) -> bool:
        return piece.goes(self.direction) and self._chance[piece.to_device].random() < self.probability


class Event(Fault):
    """A fault that happens once."""

    at_s: At = None
    after_samples: AfterSamples = None

    _one_begin = one_of("at_s", "after_samples", required=True)

    def window(self) -> Window:
        return Window(self.at_s, self.after_samples)
