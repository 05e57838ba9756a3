"""The wire as a judge of a device hears it: every frame in any format, and everything that is no frame; and one arming
of a device."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.description import Description
from firmware_protocol.frames import SETUP, Format, armed_format, frame_to_device
from hapsim.bringup.capture import POSITIONS, Capture, Decoded
from hapsim.device.connection import Connection
from hapsim.errors import DeviceError
from hapsim.loop.endings import FAILED, HUNG_UP

ANSWER_S = 0.25
"""How long one answer is waited for (PROTOCOL.md, section 8)."""

LONG_LIFE = schema.MAX_TIME_TO_LIVE_SAMPLES
"""Samples: a zero force may act for long."""

_SLICE_S = 0.05  # between two looks at whether to stop

KINDS = {
    schema.DESCRIPTION: "DESCRIPTION",
    schema.POSITION: "POSITION",
    schema.POSITION_HELD: "POSITION_HELD",
    schema.STATUS: "STATUS",
}
STATES = {schema.IDLE: "idle", schema.ARMED: "armed", schema.LATCHED: "latched"}


class Heard(NamedTuple):
    """A frame of the device, its format, and when it was read."""

    kind: int
    number: int
    counts: tuple[int, ...]
    wire: Format
    at_s: float

    @property
    def word(self) -> int:
        """The first word, unsigned."""
        return self.counts[0] & 0xFFFFFFFF

    @property
    def state(self) -> int:
        """Of a STATUS."""
        return self.word & 0xFF

    @property
    def fault(self) -> int:
        """Of a STATUS."""
        return self.word >> 8 & 0xFF

    def is_idle(self) -> bool:
        """Returns whether it is a STATUS that confirms a release."""
        return self.kind == schema.STATUS and self.state == schema.IDLE


def in_words(heard: Heard | None) -> str:
    """Returns a frame in words."""
    if heard is None:
        return "no answer"
    what = f"{KINDS[heard.kind]} {heard.number}" + (f": {heard.word}" if heard.kind == schema.DESCRIPTION else "")
    if heard.kind == schema.STATUS:
        what += f", {STATES.get(heard.state, f'state {heard.state}')}, fault {heard.fault}"
    format_name = "set-up" if heard.wire == SETUP else "armed velocity" if heard.wire.velocity else "armed"
    return f"{what}, in the {format_name} format"


class StoppedError(Exception):
    """A signal asked for the end."""


class Wire:
    """A device behind an open connection. It sends nothing by itself."""

    def __init__(self, connection: Connection, clock: Any = time) -> None:
        """`clock`: has `monotonic` and `sleep`, as the module `time` has; a test plays devices in virtual time."""
        self.name = connection.name
        self.clock = clock
        self.stop = False
        """Set to end whatever waits."""
        self.damaged: list[bytes] = []
        """What came between two delimiters and is a frame in no format."""
        self.armed = armed_format(1)
        """The format that FORCE is sent in."""
        self._connection = connection
        self._buffer = np.zeros(8192, np.uint8)
        self._capture = Capture((False,))

    @property
    def received(self) -> int:
        """Bytes so far."""
        return self._capture.counters["bytes"]

    def frame(
        self, kind: int, number: int, argument: int = 0, counts: Sequence[int] = (0,), armed: bool = False
    ) -> bytes:
        """Returns a frame of the host's, filled up with zeros."""
        wire = self.armed if armed else SETUP
        padded = [*counts, *[0] * wire.channels][: wire.channels]
        return frame_to_device(wire, kind, number % schema.SAMPLE_MODULUS, argument, padded)

    def send(self, frame: bytes) -> None:
        """Sends a frame. Raises DeviceError if the port does not take it."""
        if not self._connection.write(frame):
            raise DeviceError(f"{self.name}: the port does not take what is written to it: is the device still there?")

    def hear(self, timeout_s: float) -> list[Heard]:
        """Returns the frames among the bytes that come next, after at most this time. Raises DeviceError if the port
        hung up."""
        if self.stop:
            raise StoppedError
        count = self._connection.transport.receive(self._buffer, round(max(min(timeout_s, _SLICE_S), 0.0) * 1e9))
        if count in (HUNG_UP, FAILED):
            raise DeviceError(f"{self.name}: the device is gone (the port hung up)")
        now = self.clock.monotonic()
        found = list(self._capture.feed(self._buffer[: max(count, 0)].tobytes()))
        frames = [one for one in found if isinstance(one, Decoded)]
        begin = {one.offset for one in frames}  # bytes directly in front of a frame do no harm
        self.damaged += [
            one.data for one in found if not isinstance(one, Decoded) and one.offset + one.length not in begin
        ]
        return [Heard(one.frame.type, one.frame.number, one.frame.counts, one.wire, now) for one in frames]

    def wait_for(self, fits: Callable[[Heard], bool], seconds: float) -> tuple[Heard | None, list[Heard]]:
        """Returns the first frame that `fits`, None if none comes within this time; and every frame until then, and
        those that came with it."""
        heard: list[Heard] = []
        end = self.clock.monotonic() + seconds
        while (left := end - self.clock.monotonic()) > 0:
            new = self.hear(left)
            heard += new
            fitting = next(filter(fits, new), None)
            if fitting is not None:
                return fitting, heard
        return None, heard

    def hear_for(self, seconds: float) -> list[Heard]:
        """Returns every frame that comes within this time."""
        return self.wait_for(lambda _: False, seconds)[1]

    def ask(self, frame: bytes, kind: int, number: int | None = None) -> tuple[Heard | None, list[Heard]]:
        """Sends a frame up to four times, until one of this kind and number answers; returns that (None if none does),
        and every frame."""
        heard: list[Heard] = []
        for _ in range(4):
            self.send(frame)
            answer, new = self.wait_for(lambda one: one.kind == kind and number in (None, one.number), ANSWER_S)
            heard += new
            if answer is not None:
                return answer, heard
        return None, heard

    def register(self, number: int) -> int | None:
        """Returns what DESCRIBE of a register is answered with; None if it is not."""
        answer, _ = self.ask(self.frame(schema.DESCRIBE, number), schema.DESCRIPTION, number)
        return None if answer is None else answer.word

    def release(self) -> Heard | None:
        """Disarms in every format in which the device may listen; returns its STATUS, None if there was none. A request
        to stop does not end it."""
        self.stop = False
        for armed in (True, False) * 3:
            self.send(self.frame(schema.DISARM, 0, armed=armed))
            answer, _ = self.wait_for(Heard.is_idle, 0.1)
            if answer is not None:
                return answer
        return None


@dataclass
class Sample:
    """A position as it came."""

    n: int
    """Its number, counted on beyond 4096."""
    fresh: bool
    counts: tuple[int, ...]
    at_s: float

    def in_words(self) -> str:
        """Returns its frame's type and its number."""
        return f"{'POSITION' if self.fresh else 'POSITION_HELD'} {self.n}"


@dataclass
class Session:
    """An armed device. `samples`: every position since arming, in order."""

    wire: Wire
    status: Heard | None
    """What ARM was answered with."""
    patience_s: float = 0.5
    """How long a silence is no failure."""
    samples: list[Sample] = field(default_factory=list)
    sent_at_s: dict[int, float] = field(default_factory=dict)
    """When each sample was answered, before the next position was read."""
    sent: int = 0
    """FORCE frames that answer a sample."""
    others: list[Heard] = field(default_factory=list)
    """Every other frame than positions in the expected format."""
    ended: Heard | None = None
    """STATUS that came unasked."""

    @property
    def newest(self) -> Sample | None:
        """The last position."""
        return self.samples[-1] if self.samples else None

    def take(self, heard: Sequence[Heard]) -> None:
        """Sorts frames."""
        for one in heard:
            # A device that releases by itself may say so in the wrong format.
            ends = one.kind == schema.STATUS and (one.wire != SETUP or one.state == schema.LATCHED)
            if one.kind in POSITIONS and one.wire == self.wire.armed and self.ended is None:
                last = self.samples[-1].n if self.samples else -1
                n = last + (one.number - last) % schema.SAMPLE_MODULUS
                self.samples.append(Sample(n, one.kind == schema.POSITION, one.counts, one.at_s))
            elif ends and self.ended is None:
                self.ended = one
            else:
                self.others.append(one)

    def force(self, n: int, counts: Sequence[int] = (0,), time_to_live: int = LONG_LIFE) -> None:
        """Answers sample n."""
        self.sent += 1
        self.wire.send(self.wire.frame(schema.FORCE, n, time_to_live, counts, armed=True))
        self.sent_at_s[n] = self.wire.clock.monotonic()

    def zero(self, sample: Sample) -> None:
        """Answers a sample with no force."""
        self.force(sample.n)

    def next_positions(self) -> bool:
        """Takes what comes next; returns False if no position came for as long as the patience lasts, or a STATUS."""
        before, end = len(self.samples), self.wire.clock.monotonic() + self.patience_s
        while len(self.samples) == before and self.ended is None and self.wire.clock.monotonic() < end:
            self.take(self.wire.hear(0.05))
        return len(self.samples) > before

    def run(self, samples: int, answer: Callable[[Sample], None] | None) -> bool:
        """Runs for this many samples; `answer` is called with each newest position. Returns whether they came."""
        last = self.newest.n + samples if self.newest else samples
        while self.ended is None and (self.newest is None or self.newest.n < last):
            if not self.next_positions():
                return False
            if answer is not None and self.ended is None:
                answer(self.samples[-1])
        return self.ended is None

    def disarm(self) -> Heard | None:
        """Sends DISARM in the armed format; returns the STATUS that answers. Without one it releases the device in any
        format, and returns None. Every position before it is taken."""
        self.wire.send(self.wire.frame(schema.DISARM, 0, armed=True))
        answer, heard = self.wire.wait_for(Heard.is_idle, 4 * ANSWER_S)
        self.take(heard)
        if answer is None:
            self.wire.release()
        return answer


def arm_frame(
    wire: Wire, pacing: int, watchdog: int, *, velocity: bool = False, word: int = schema.SCHEMA_HASH
) -> bytes:
    """Returns ARM; `word`: its schema hash."""
    signed = (word & 0xFFFFFFFF) - ((word & 0x80000000) << 1)
    return wire.frame(schema.ARM, watchdog, pacing | (schema.WITH_VELOCITY if velocity else 0), [signed])


def arm(wire: Wire, device: Description, pacing: int, watchdog: int, *, velocity: bool = False) -> Session:
    """Sends ARM. The status of the session says whether the device took it."""
    wire.armed = armed_format(device.channels, velocity)
    answer, heard = wire.ask(arm_frame(wire, pacing, watchdog, velocity=velocity), schema.STATUS)
    session = Session(wire, answer, 0.5 + 20.0 / device.rate_hz)
    session.take([one for one in heard if one is not answer])
    return session
