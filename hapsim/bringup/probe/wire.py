"""The wire as a judge of a device hears it: every frame with its format, and everything that is no frame; and one
arming of a device.

Between two delimiters there is one frame in one of the formats, or bytes that are none: the check's start value keeps
the formats apart. So the format that a device speaks is seen, whichever it ought to speak.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import frames_in, new_decoder
from firmware_protocol.frames import SETUP, Format, armed_format, frame_to_device
from hapsim.device.connection import Connection
from hapsim.errors import DeviceError
from hapsim.loop.endings import FAILED, HUNG_UP

SET_UP, ARMED, WITH_VELOCITIES = "set-up", "armed", "armed with velocities"

ANSWER_S = 0.25
"""How long one answer is waited for (PROTOCOL.md, section 8)."""

_SLICE_S = 0.05  # between two looks at whether to stop
_FORGOTTEN = 1 << 16  # bytes between two delimiters: more are no frame whatever follows


class Heard(NamedTuple):
    """A frame of the device, in which format it was, and when it was read."""

    kind: int
    number: int
    counts: tuple[int, ...]
    wire: str
    at_s: float

    @property
    def word(self) -> int:
        return self.counts[0] & 0xFFFFFFFF

    @property
    def state(self) -> int:
        return self.word & 0xFF

    @property
    def fault(self) -> int:
        return self.word >> 8 & 0xFF


KINDS = {
    schema.DESCRIPTION: "DESCRIPTION",
    schema.POSITION: "POSITION",
    schema.POSITION_HELD: "POSITION_HELD",
    schema.STATUS: "STATUS",
}
STATES = {schema.IDLE: "idle", schema.ARMED: "armed", schema.LATCHED: "latched"}


def told(heard: Heard | None) -> str:
    """A frame in words."""
    if heard is None:
        return "no answer"
    what = f"{KINDS[heard.kind]} {heard.number}"
    if heard.kind == schema.STATUS:
        what += f", {STATES.get(heard.state, f'state {heard.state}')}, fault {heard.fault}"
    return f"{what}, in the {heard.wire} format"


class Clock:
    """The system's; another one plays devices in virtual time."""

    def now(self) -> float:
        """s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        time.sleep(seconds)


class StoppedError(Exception):
    """Somebody asked for the end."""


class Wire:
    """A device behind an open connection; nothing is done but what is asked for."""

    def __init__(self, connection: Connection, clock: Clock | None = None) -> None:
        self.name = connection.name
        self.clock = clock or Clock()
        self.stop = False
        self.received = 0
        """Bytes."""
        self.damaged: list[bytes] = []
        """What came between two delimiters and is a frame in no format."""
        self.garbage_bytes = 0
        """In front of frames."""
        self.written = b""
        """What was sent last."""
        self.armed = armed_format(1)
        """The format that FORCE is sent in."""
        self._connection = connection
        self._buffer = np.zeros(8192, np.uint8)
        self._rest = b""
        self._formats: dict[str, Format] = {}
        self.know_channels(1)

    def know_channels(self, channels: int) -> None:
        """From now on, hears the armed formats of so many channels."""
        self._formats = {
            SET_UP: SETUP,
            ARMED: armed_format(channels),
            WITH_VELOCITIES: armed_format(channels, velocity=True),
        }
        self._decoders = {name: new_decoder(wire, to_device=False) for name, wire in self._formats.items()}
        self._likely = SET_UP

    def expect(self, name: str) -> None:
        """FORCE is sent in this format from now on; frames in any are heard."""
        if name != SET_UP:
            self.armed = self._formats[name]

    def frame(
        self, kind: int, number: int, argument: int = 0, counts: Sequence[int] = (0,), armed: bool = False
    ) -> bytes:
        """A frame of the host's, filled up with zeros."""
        wire = self.armed if armed else SETUP
        padded = [*counts, *[0] * wire.channels][: wire.channels]
        return frame_to_device(wire, kind, number % schema.SAMPLE_MODULUS, argument, padded)

    def send(self, frame: bytes) -> None:
        """DeviceError where the port does not take it."""
        self.written = frame
        if not self._connection.write(frame):
            raise DeviceError(f"{self.name}: the port does not take what is written to it: is the device still there?")

    def hear(self, timeout_s: float) -> list[Heard]:
        """The frames among the bytes that come next, waited for at most so long. DeviceError where the port hung up."""
        if self.stop:
            raise StoppedError
        count = self._connection.transport.receive(self._buffer, round(max(min(timeout_s, _SLICE_S), 0.0) * 1e9))
        if count in (HUNG_UP, FAILED):
            raise DeviceError(f"{self.name}: the device is gone (the port hung up)")
        return self._read(self._buffer[:count].tobytes()) if count > 0 else []

    def hear_for(self, seconds: float) -> list[Heard]:
        """Every frame that comes within so long."""
        heard, end = [], self.clock.now() + seconds
        while (left := end - self.clock.now()) > 0:
            heard += self.hear(left)
        return heard

    def wait_for(self, fits: Callable[[Heard], bool], seconds: float) -> tuple[Heard | None, list[Heard]]:
        """The first frame that `fits`, None where none comes within so long; and every frame until then, and those that
        came with it."""
        heard: list[Heard] = []
        end = self.clock.now() + seconds
        while (left := end - self.clock.now()) > 0:
            new = self.hear(left)
            heard += new
            for one in new:
                if fits(one):
                    return one, heard
        return None, heard

    def ask(self, frame: bytes, fits: Callable[[Heard], bool], tries: int = 4) -> tuple[Heard | None, list[Heard]]:
        """Sends a frame until something that `fits` answers; and all that was heard."""
        heard: list[Heard] = []
        for _ in range(tries):
            self.send(frame)
            answer, new = self.wait_for(fits, ANSWER_S)
            heard += new
            if answer is not None:
                return answer, heard
        return None, heard

    def register(self, number: int) -> int | None:
        """What DESCRIBE of a register is answered with; None where it is not."""
        answer, _ = self.ask(
            self.frame(schema.DESCRIBE, number), lambda one: one.kind == schema.DESCRIPTION and one.number == number
        )
        return None if answer is None else answer.word

    def release(self) -> Heard | None:
        """Disarms, in whatever format the device listens: its STATUS, None where it said none. It stops for nothing."""
        self.stop = False
        frames = [self.frame(schema.DISARM, 0, armed=True), self.frame(schema.DISARM, 0)]
        for _ in range(3):
            for frame in frames:
                self.send(frame)
                answer, _ = self.wait_for(lambda one: one.kind == schema.STATUS and one.state == schema.IDLE, 0.1)
                if answer is not None:
                    return answer
        return None

    def _read(self, data: bytes) -> list[Heard]:
        now = self.clock.now()
        self.received += len(data)
        *pieces, self._rest = (self._rest + data).split(b"\0")
        self._rest = self._rest[-_FORGOTTEN:]
        found = (self._read_piece(piece, now) for piece in pieces if piece)
        return [one for one in found if one is not None]

    def _read_piece(self, piece: bytes, now: float) -> Heard | None:
        for name in sorted(self._decoders, key=lambda name: name != self._likely):
            decoder = self._decoders[name]
            before = int(decoder.garbage_bytes)
            frames = frames_in(decoder, piece + b"\0")
            if frames:
                self._likely = name
                self.garbage_bytes += int(decoder.garbage_bytes) - before
                return Heard(frames[0].type, frames[0].number, frames[0].counts, name, now)
        self.damaged.append(piece)
        return None


POSITIONS = (schema.POSITION, schema.POSITION_HELD)

LONG_LIFE = schema.MAX_TIME_TO_LIVE_SAMPLES
"""Samples: a zero force may act for long."""


@dataclass
class Sample:
    """A position as it came."""

    n: int
    """Its number, counted on beyond 4096."""
    fresh: bool
    counts: tuple[int, ...]
    at_s: float


@dataclass
class Session:
    """An armed device. `samples`: every position since arming, in order."""

    wire: Wire
    status: Heard | None
    """What ARM was answered with."""
    samples: list[Sample] = field(default_factory=list)
    answered: dict[int, Sequence[int]] = field(default_factory=dict)
    """The force that was sent for each sample, in counts, before the next position was read."""
    sent: int = 0
    """FORCE frames that answer a sample."""
    others: list[Heard] = field(default_factory=list)
    """Whatever came beside positions in the format that was asked for."""
    ended: Heard | None = None
    """STATUS that came unasked."""
    sent_at_s: dict[int, float] = field(default_factory=dict)

    @property
    def newest(self) -> Sample | None:
        return self.samples[-1] if self.samples else None

    @property
    def format(self) -> str:
        return WITH_VELOCITIES if self.wire.armed.velocity else ARMED

    def take(self, heard: Sequence[Heard]) -> None:
        """Sorts frames."""
        for one in heard:
            if one.kind in POSITIONS and one.wire == self.format and self.ended is None:
                last = self.samples[-1].n if self.samples else -1
                n = last + (one.number - last) % schema.SAMPLE_MODULUS
                self.samples.append(Sample(n, one.kind == schema.POSITION, one.counts, one.at_s))
            elif _ends(one) and self.ended is None:
                self.ended = one
            else:
                self.others.append(one)

    def force(self, n: int, counts: Sequence[int] = (0,), time_to_live: int = LONG_LIFE) -> None:
        """Answers sample n."""
        self.answered[n] = counts
        self.sent += 1
        self.wire.send(self.wire.frame(schema.FORCE, n, time_to_live, counts, armed=True))
        self.sent_at_s[n] = self.wire.clock.now()

    def run(self, samples: int, answer: Callable[[Sample], None] | None) -> bool:
        """Until so many more samples have passed; `answer` is called with each newest position. Whether they came: no
        STATUS before, no silence of half a second and 20 samples."""
        last = self.newest.n + samples if self.newest else samples
        quiet_since = self.wire.clock.now()
        while self.ended is None and (self.newest is None or self.newest.n < last):
            before = len(self.samples)
            self.take(self.wire.hear(0.05))
            if len(self.samples) > before:
                quiet_since = self.wire.clock.now()
                if answer is not None and self.ended is None:
                    answer(self.samples[-1])
            elif self.wire.clock.now() - quiet_since > self.patience_s:
                return False
        return self.ended is None

    patience_s: float = 0.5

    def zero(self, sample: Sample) -> None:
        """The answer that asks for no force."""
        self.force(sample.n)

    def disarm(self) -> Heard | None:
        """Sends DISARM in the armed format; returns the STATUS that answers. Without one it releases the device in any
        format, and returns None. Every position before it is taken."""
        self.wire.send(self.wire.frame(schema.DISARM, 0, armed=True))
        answer, heard = self.wire.wait_for(_is_idle, 4 * ANSWER_S)
        self.take(heard)
        if answer is None:
            self.wire.release()
        return answer


def _ends(one: Heard) -> bool:
    """Whether an armed device says that it has released by itself, be it in the wrong format."""
    return one.kind == schema.STATUS and (one.wire != SET_UP or one.state == schema.LATCHED)


def _is_idle(one: Heard) -> bool:
    return one.kind == schema.STATUS and one.state == schema.IDLE


def arm_frame(
    wire: Wire, pacing: int, watchdog: int, *, velocity: bool = False, word: int = schema.SCHEMA_HASH
) -> bytes:
    """ARM."""
    signed = (word & 0xFFFFFFFF) - ((word & 0x80000000) << 1)
    return wire.frame(schema.ARM, watchdog, pacing | (schema.WITH_VELOCITY if velocity else 0), [signed])


def arm(wire: Wire, rate_hz: float, pacing: int, watchdog: int, *, velocity: bool = False) -> Session:
    """Arms; whether the device took it stands in the session's status."""
    wire.expect(WITH_VELOCITIES if velocity else ARMED)
    answer, heard = wire.ask(
        arm_frame(wire, pacing, watchdog, velocity=velocity), lambda one: one.kind == schema.STATUS
    )
    session = Session(wire, answer, patience_s=0.5 + 20.0 / rate_hz)
    session.take([one for one in heard if one is not answer])
    return session
