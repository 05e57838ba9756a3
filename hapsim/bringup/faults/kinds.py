"""Every kind of fault, in the order of `hapsim faults --list`.

Those of the wire do not look into a frame: frames lost, damaged, repeated, late or swapped; noise; a plug. Those of a
device do: it restarts, describes itself wrongly, its sensor leaps, its timer or a sign is wrong.
"""

from __future__ import annotations

import math
import struct
from dataclasses import replace
from typing import Annotated, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, PrivateAttr, model_validator

from firmware_protocol import schema
from firmware_protocol.capture import Registers
from firmware_protocol.frames import SETUP, Format, frame_to_device
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
    one_of,
    tidy,
)
from hapsim.scene.quantity import count, quantity
from hapsim.scene.schemas import unexpected


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

    _one_period = one_of("every", "every_samples")

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


class _Quiet(Event):
    """Nothing passes in one direction."""

    counted: ClassVar[str] = "frames lost"
    direction: Direction = Field(default="from_device", description="The direction in which nothing passes")
    lasts_s: For = None
    for_samples: ForSamples = None

    _one_length = one_of("lasts_s", "for_samples")

    def window(self) -> Window:
        return Window(self.at_s, self.after_samples, self.lasts_s, self.for_samples)

    def hits(self, piece: Piece) -> bool:
        return piece.goes(self.direction)


class HalfFrame(_Quiet):
    """A frame breaks off in its middle; then nothing passes."""

    counted: ClassVar[str] = "frames lost or cut"
    kind: Literal["half_frame"] = "half_frame"

    def change(self, piece: Piece) -> list[Piece]:
        return [piece.damaged(piece.data[: len(piece.data) // 2])] if self.count == 1 else []


class Silence(_Quiet):
    """Nothing passes, while the port stays open."""

    kind: Literal["silence"] = "silence"


class _Plug(Event):
    """The port goes or comes."""

    counted: ClassVar[str] = "times"

    def pass_time(self, now: Moment) -> list[Piece]:
        self._happens_once(now)
        return []


class Unplug(_Plug):
    """The port disappears: a program that has it open is hung up."""

    plugs: ClassVar[bool | None] = False
    kind: Literal["unplug"] = "unplug"


class Replug(_Plug):
    """The port is there again, under the name of before (--path)."""

    plugs: ClassVar[bool | None] = True
    kind: Literal["replug"] = "replug"


class Reboot(Event):
    """The device falls silent, and comes back in its set-up state, disarmed."""

    counted: ClassVar[str] = "times"
    kind: Literal["reboot"] = "reboot"
    seconds: Annotated[float, quantity("How long it takes to come back", "s", above=0)] = 0.5

    _wire: Format = SETUP  # that the device was last heard to speak

    def window(self) -> Window:
        return Window(self.at_s, self.after_samples, self.seconds)

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        if piece.found is not None and not piece.to_device:
            self._wire = piece.found.wire
        return [] if self._window.is_open(now) else [piece]

    def pass_time(self, now: Moment) -> list[Piece]:
        """Disarms the device behind it, as a reset does. Its answer does not pass."""
        if not self._happens_once(now):
            return []
        disarm = frame_to_device(self._wire, schema.DISARM, 0, 0, np.zeros(self._wire.channels, np.int64))
        return [Piece(disarm, to_device=True)]


_WHOLE = {
    "channels": schema.REG_CHANNELS,
    "pacings": schema.REG_PACINGS,
    "max_watchdog": schema.REG_MAX_WATCHDOG,
    "schema": schema.REG_SCHEMA,
}
_REALS = {"nan": math.nan, "zero": 0.0, "negative": -1.0, "huge": 1e300}
_INTEGERS = {"zero": 0, "negative": -1, "huge": 2**31 - 1}


class _Description(Lasting):
    """Answers DESCRIBE with other words."""

    counted: ClassVar[str] = "answers changed"

    def words(self) -> dict[int, int]:
        """Returns the answers, signed, by register."""
        raise NotImplementedError

    def hits(self, piece: Piece) -> bool:
        return piece.is_from_device(schema.DESCRIPTION, numbers=self.words())

    def change(self, piece: Piece) -> list[Piece]:
        return [piece.rewritten(counts_of=lambda frame: [self.words()[frame.number]])]


class Version(_Description):
    """The device says that it speaks another version of the protocol."""

    kind: Literal["version"] = "version"
    answers: Annotated[int, count("The version that it says it speaks", 0, 2**31 - 1)] = 2

    def words(self) -> dict[int, int]:
        return {schema.REG_VERSION: self.answers}


_Register = Literal[
    "rate",
    "position_scale",
    "force_scale",
    "force_limit",
    "velocity_scale",
    "channels",
    "pacings",
    "max_watchdog",
    "schema",
]


class Nonsense(_Description):
    """The device declares a rate, a scale, a limit or a number that cannot be."""

    kind: Literal["nonsense"] = "nonsense"
    register_: _Register = Field(alias="register", description="The register, by its name in PROTOCOL.md, section 5")
    what: Literal["nan", "zero", "negative", "huge"] = Field(description="What it says")

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.register_ in _WHOLE and self.what not in _INTEGERS:
            expected = f"zero, negative or huge of {self.register_}: it is a whole number, and none of them is nan"
            unexpected(expected, found=self.what)
        return self

    def words(self) -> dict[int, int]:
        """A double is two registers, the low word first; a scale or limit is wrong on every channel."""
        if self.register_ in _WHOLE:
            return {_WHOLE[self.register_]: _INTEGERS[self.what]}
        low, high = struct.unpack("<ii", struct.pack("<d", _REALS[self.what]))
        places = [schema.REG_RATE]
        if self.register_ != "rate":
            first = schema.REG_CHANNEL + schema.CHANNEL_REGISTERS[self.register_]
            places = [first + channel * schema.CHANNEL_WORDS for channel in range(schema.MAX_CHANNELS)]
        return {at + k: word for at in places for k, word in enumerate((low, high))}


class Rate(Lasting):
    """The device samples at a factor of the rate that it declares."""

    counted: ClassVar[str] = "positions dropped or repeated"
    kind: Literal["rate"] = "rate"
    factor: Annotated[float, quantity("The rate over the declared one", "1", least=0.01, most=10)]

    # What the host sees is numbered one by one; a force then names the sample that the device knows.
    _due: float = 0.0  # samples that the host is to see, and has not seen
    _seen: int | None = None  # the number of the last one that it saw
    _true: list[int] = [0] * schema.SAMPLE_MODULUS  # the device's number of each that it saw

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Drops or repeats a position, and renumbers it; a force gets the number that the device knows."""
        frame = piece.frame
        if frame is None:
            return [piece]
        if piece.is_from_device(schema.STATUS):
            self._seen, self._due = None, 0.0  # armed anew, or over: it counts from 0
        if piece.to_device and frame.type == schema.FORCE and self._seen is not None:
            return [piece.rewritten(number=self._true[frame.number])]
        if not piece.is_from_device(*schema.POSITIONS):
            return [piece]
        is_open = self._window.is_open(now)
        if self._seen is None:
            if not is_open:
                self._true[frame.number] = frame.number
                return [piece]
            self._seen = frame.number - 1
        self._due += self.factor if is_open else 1.0
        passed = []
        while self._due >= 1.0:
            self._due -= 1.0
            self._seen = (self._seen + 1) % schema.SAMPLE_MODULUS
            self._true[self._seen] = frame.number
            passed.append(piece.rewritten(number=self._seen))
        self._count += len(passed) != 1
        return passed


class Leap(Event):
    """The positions are elsewhere from one sample to the next, and go on from there."""

    counted: ClassVar[str] = "positions moved"
    kind: Literal["leap"] = "leap"
    metres: Annotated[float | None, quantity("How far", "m", left_out="counts says it")] = None
    counts: Annotated[int | None, count("How far, in place of metres", -(2**31), 2**31 - 1, "counts")] = None
    channel: Annotated[int, count("Of which channel", 0, schema.MAX_CHANNELS - 1)] = 0

    _described: Registers = PrivateAttr(default_factory=Registers)  # the scale, if only metres are given

    _one_way = one_of("metres", "counts", required=True)

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Moves a position. Notes the position scale from the description on the way."""
        frame, leaping = piece.frame, self.channel
        if frame is None or piece.to_device:
            return [piece]
        self._described.note(frame)
        by = self._counts() if frame.type in schema.POSITIONS else None
        if by is None or leaping >= len(frame.counts) or not self._window.is_open(now):
            return [piece]
        self._count += 1
        return [piece.rewritten(counts_of=lambda frame: [n + by * (c == leaping) for c, n in enumerate(frame.counts)])]

    def _counts(self) -> int | None:
        """Returns how far, in counts; None if the device did not say how long one is."""
        if self.metres is None:
            return self.counts
        scale = self._described.scale(schema.REG_POSITION_SCALE, self.channel)
        return round(self.metres / scale) if scale else None


class _Stale(Lasting):
    """A sensor that is not read, but answers: a channel's position, and its velocity, stay what they were."""

    counted: ClassVar[str] = "positions held"
    channel: Annotated[int, count("Of which channel", 0, schema.MAX_CHANNELS - 1)] = 0

    _held: list[int] | None = None  # the words of this channel that passed last; None since it was armed

    def take(self, piece: Piece, now: Moment) -> list[Piece]:
        """Passes a position on, and keeps it; or says the kept one again."""
        if piece.is_from_device(schema.STATUS):
            self._held = None
        frame, found = piece.frame, piece.found
        if frame is None or found is None or not piece.is_from_device(*schema.POSITIONS):
            return [piece]
        words, own = list(frame.counts), slice(self.channel, None, found.wire.channels)
        if self.channel >= found.wire.channels:
            return [piece]
        if not self._window.is_open(now) or self._is_read(now) or self._held is None:
            self._held = words[own]
            return [piece]
        words[own] = self._held
        self._count += 1
        return [piece.rewritten(counts_of=lambda _: words)]

    def _is_read(self, _now: Moment) -> bool:
        """Returns whether the sensor is read at this sample."""
        return False


class Freeze(_Stale):
    """The position of a channel stands still, whatever moves: a sensor that is dead but answers."""

    kind: Literal["freeze"] = "freeze"


class Refresh(_Stale):
    """The position of a channel changes only every so often, as that of a sensor that is read too seldom."""

    kind: Literal["refresh"] = "refresh"
    every: Annotated[float | None, quantity("How often", "s", above=0, left_out="every_samples says it")] = None
    every_samples: Annotated[int | None, count("How often, in place of a time", 1, 2**31, "samples")] = None

    _due = Moment(0.0, 0)

    _one_interval = one_of("every", "every_samples", required=True)

    def _is_read(self, now: Moment) -> bool:
        if is_due := now.has_reached(self._due):
            self._due = now.after(self.every, self.every_samples)
        return is_due


class Invert(Event):
    """Positions (from_device) or forces (to_device) have the other sign from then on."""

    counted: ClassVar[str] = "frames inverted"
    kind: Literal["invert"] = "invert"
    direction: Literal["from_device", "to_device"] = Field(
        default="from_device", description="from_device: positions and velocities; to_device: forces"
    )

    def hits(self, piece: Piece) -> bool:
        inverted = (schema.FORCE,) if self.direction == "to_device" else schema.POSITIONS
        return piece.goes(self.direction) and piece.frame is not None and piece.frame.type in inverted

    def change(self, piece: Piece) -> list[Piece]:
        return [piece.rewritten(counts_of=lambda frame: [-count for count in frame.counts])]
