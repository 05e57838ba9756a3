"""A device that is being judged: its wire, one arming of it, the checks (`checks.yaml`), and what was found so far.

Its wire is received in every format, with everything that is no frame.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml

from firmware_protocol import schema
from firmware_protocol.capture import Capture, Decoded
from firmware_protocol.client import ANSWER_S, Client, Received
from firmware_protocol.description import Description
from firmware_protocol.frames import SETUP
from hapsim.device.connection import Connection
from hapsim.units import Units

LONG_LIFE = schema.MAX_TIME_TO_LIVE_SAMPLES
"""Samples: a zero force may act for long."""

_SLICE_S = 0.05  # between two looks at whether to stop


def in_words(one: Received | None) -> str:
    """Returns a frame in words."""
    if one is None:
        return "no answer"
    what = f"{schema.TYPES[one.kind]} {one.number}" + (f": {one.word}" if one.kind == schema.DESCRIPTION else "")
    if one.kind == schema.STATUS:
        what += f", {schema.STATES.get(one.state, f'state {one.state}')}, fault {one.fault}"
    format_name = "set-up" if one.wire == SETUP else " ".join(["armed", *one.wire.part_names])
    return f"{what}, in the {format_name} format"


class StoppedError(Exception):
    """A signal asked for the end."""


class Wire(Client):
    """A device behind an open connection, received in every format."""

    def __init__(self, connection: Connection, clock: Any = time) -> None:
        """`clock`: of a `Client`."""
        self.name, self.clock = connection.name, clock
        self.stop = False
        """Set to end whatever waits."""
        self.damaged: list[bytes] = []
        """Bytes between two delimiters that are a frame in no format."""
        self._connection, self._capture, self._releasing = connection, Capture((False,)), False

    @property
    def received(self) -> int:
        """Bytes so far."""
        return self._capture.counters["bytes"]

    def send(self, frame: bytes) -> None:
        self._connection.send(frame)

    def receive(self, timeout_s: float) -> list[Received]:
        """Returns the frames among the bytes that come next. Raises DeviceError, and StoppedError."""
        if self.stop and not self._releasing:
            raise StoppedError
        found = list(self._capture.feed(self._connection.receive_bytes(max(min(timeout_s, _SLICE_S), 0.0))))
        now = self.clock.monotonic()
        frames = [one for one in found if isinstance(one, Decoded)]
        begin = {one.offset for one in frames}  # bytes directly in front of a frame do no harm
        self.damaged += [
            one.data for one in found if not isinstance(one, Decoded) and one.offset + one.length not in begin
        ]
        return [Received(one.frame.type, one.frame.number, one.frame.counts, one.wire, now) for one in frames]

    def release(self, *how: Any, **options: Any) -> Received | None:
        """Disarms as a `Client` does; a request to stop does not end it."""
        self._releasing = True
        try:
            return super().release(*how, **options)
        finally:
            self._releasing = False


@dataclass
class Sample:
    """A position as it came."""

    n: int
    """Number of the sample, counted on beyond 4096."""
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
    status: Received | None
    """Answer to ARM."""
    patience_s: float = 0.5
    """Timeout for the device's answer."""
    samples: list[Sample] = field(default_factory=list)
    sent_at_s: dict[int, float] = field(default_factory=dict)
    """Time of each sample's answer, before the next position was read."""
    sent: int = 0
    """FORCE frames that answer a sample."""
    others: list[Received] = field(default_factory=list)
    """Every other frame than positions in the expected format."""
    ended: Received | None = None
    """STATUS that came unasked."""

    @property
    def newest(self) -> Sample | None:
        """The last position."""
        return self.samples[-1] if self.samples else None

    def take(self, frames: Sequence[Received]) -> None:
        """Sorts frames."""
        for one in frames:
            # A device that releases by itself may say so in the wrong format.
            ends = one.kind == schema.STATUS and (one.wire != SETUP or one.state == schema.LATCHED)
            if one.kind in schema.POSITIONS and one.wire == self.wire.armed and self.ended is None:
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
            self.take(self.wire.receive(0.05))
        return len(self.samples) > before

    def take_waiting(self) -> None:
        """Takes what has come by now."""
        while new := self.wire.receive(0.0):
            self.take(new)

    def run(self, samples: int, answer: Callable[[Sample], None] | None) -> bool:
        """Runs for this many samples; `answer` is called with each newest position. Returns whether they came."""
        last = self.newest.n + samples if self.newest else samples
        while self.ended is None and (self.newest is None or self.newest.n < last):
            if not self.next_positions():
                return False
            if answer is not None and self.ended is None:
                answer(self.samples[-1])
        return self.ended is None

    def disarm(self) -> Received | None:
        """Sends DISARM in the armed format; returns the STATUS that answers. Without one it releases the device in any
        format, and returns None. Every position before it is taken."""
        self.wire.send(self.wire.frame(schema.DISARM, 0, armed=True))
        answer, frames = self.wire.wait_for(
            lambda one: one.kind == schema.STATUS and one.state == schema.IDLE, 4 * ANSWER_S
        )
        self.take(frames)
        if answer is None:
            self.wire.release()
        return answer


def arm(wire: Wire, device: Description, pacing: int, watchdog: int, *, parts: int = 0) -> Session:
    """Sends ARM. The status of the session says whether the device took it."""
    answer, received = wire.arm(device, pacing, watchdog, parts=parts)
    session = Session(wire, answer, 0.5 + 20.0 / device.rate_hz)
    session.take([one for one in received if one is not answer])
    return session


Result = Literal["pass", "FAIL", "not seen"]


@dataclass(frozen=True)
class Check:
    """A check, and what was found."""

    name: str
    step: str
    section: str
    title: str
    """Title of the section."""
    expected: str
    look_at: str = ""
    """Advice on the cause; empty in a result that has no fault."""
    result: Result = "not seen"
    found: str = "not reached"


_TABLE = yaml.safe_load(Path(__file__).with_name("checks.yaml").read_text("utf-8"))

SECTIONS: dict[str, str] = _TABLE["sections"]
"""The titles of PROTOCOL.md's sections, by number."""

STEPS: tuple[str, ...] = tuple(_TABLE["steps"])

CHECKS = tuple(
    Check(name, step, title=SECTIONS[keys["section"]], **keys)
    for step, checks in _TABLE["steps"].items()
    for name, keys in checks.items()
)

_DECLARED = {check.name: check for check in CHECKS}


@dataclass(frozen=True)
class Leave:
    """The user's permission to push, on one channel, or on a pair."""

    force: float
    """N at most, to either side."""
    travel: float
    """m at most, from where the pushing began; 0: what is usual for the device's motion."""
    channel: int = 0
    mass: float | None = None
    """kg, with the hand; None if it is unknown."""
    pair: tuple[int, ...] = ()
    """Both channels of a hand in the plane, `channel` first: the other is pushed too, and they are judged as one."""
    require: Callable[[Units], None] = lambda _units: None
    """Called with the channel's units before it is pushed; raises UsageError where the permission is in others."""

    @property
    def channels(self) -> tuple[int, ...]:
        """The channels that may be pushed."""
        return self.pair or (self.channel,)

    @property
    def named(self) -> str:
        """Their names in words."""
        return f"channels {self.pair[0]} and {self.pair[1]}" if self.pair else f"channel {self.channel}"


class Probing:
    """A device that is being judged: its wire, its description, what the user allows, and what was found."""

    def __init__(self, wire: Wire, leave: Leave | None = None) -> None:
        self.wire, self.leave = wire, leave
        self.results: dict[str, Check] = {}
        """Results so far, by the check's name."""
        self.description: Description | None = None
        self.response: float | None = None
        """m/s² per N, as the pushes found it."""

    def judge(self, name: str, kept: bool, found: str, look_at: str = "") -> bool:
        """Notes that a check passed or failed, by `kept`, and returns that. The first failure of a check stays: what
        comes after it may follow from it. `look_at`: in place of the advice of the table."""
        if not self.has_failed(name):
            advice = "" if kept else look_at or _DECLARED[name].look_at
            self._note(name, "pass" if kept else "FAIL", found, advice)
        return kept

    def not_seen(self, names: str | Iterable[str], why: str, look_at: str = "") -> None:
        """Notes that a check, or each of several, could not run, unless it has a result."""
        for name in [names] if isinstance(names, str) else names:
            if name not in self.results:
                self._note(name, "not seen", why, look_at)

    def leave_out(self, step: str, why: str) -> None:
        """Notes that the checks of a step that have no result could not run."""
        self.not_seen(_TABLE["steps"][step], why)

    def judge_taken(
        self, name: str, session: Session, going: bool, wrong: Sequence[Received], register: int = 0
    ) -> None:
        """Disarms the device, and judges whether samples went on, nothing else came than `wrong`, and each force was
        taken, or came too late. `register`: a counter that stays 0."""
        other = [in_words(one) for one in (*wrong, session.ended) if one]
        found = "; ".join([f"{len(session.samples)} positions", *other[:1]])
        if session.disarm() is None or not going or other:
            self.judge(name, False, found)
            self.wire.release()
            return
        numbers = (schema.REG_ACCEPTED, schema.REG_EXPIRED, *([register] if register else []))
        counted = {number: self.wire.register(number) for number in numbers}
        accepted, expired, *others = counted.values()
        kept = (
            accepted is not None and expired is not None and accepted + expired == session.sent and others in ([], [0])
        )
        read = ", ".join(f"register {number}: {count}" for number, count in counted.items())
        self.judge(name, kept, f"{found}; {read}; {session.sent} were sent")

    def fail_next(self, step: str, found: str, look_at: str) -> None:
        """Notes that the first check of a step that has no result failed."""
        for name in [name for name in _TABLE["steps"][step] if name not in self.results][:1]:
            self.judge(name, False, found, look_at)

    def has_failed(self, name: str) -> bool:
        """Returns whether a check has failed so far."""
        return name in self.results and self.results[name].result == "FAIL"

    def _note(self, name: str, result: Result, found: str, look_at: str) -> None:
        self.results[name] = replace(_DECLARED[name], result=result, found=found, look_at=look_at)

    @property
    def units(self) -> Units:
        """The units of the device's channels, as far as it said so."""
        return Units.of(() if self.description is None else self.description.motions)

    def units_of(self, channel: int) -> Units:
        """The units of one of the device's channels."""
        return Units.of(self.device.motions[channel : channel + 1])

    @property
    def device(self) -> Description:
        """Description of the device, available once its registers are plausible."""
        assert self.description is not None, "no step that arms comes before the registers"
        return self.description

    def periods(self, samples: float) -> float:
        """Returns how long this many samples take, in s."""
        return samples / self.device.rate_hz

    def samples_in(self, seconds: float, least: int, most: int) -> int:
        """Returns how many samples a time has, within bounds."""
        return min(max(round(seconds * self.device.rate_hz), least), most)

    def arm(self, pacing: int, watchdog: int, *, parts: int = 0) -> Session | None:
        """Arms the device; returns None, and releases it, if it did not arm."""
        session = arm(self.wire, self.device, pacing, watchdog, parts=parts)
        if session.status is not None and session.status.state == schema.ARMED:
            return session
        self.wire.release()
        return None

    def arm_by_device(self, step: str, watchdog: int, *, parts: int = 0) -> Session | None:
        """Arms the device, paced by itself; returns None, and leaves out the step, if it did not arm."""
        session = None
        if not self.device.paces(schema.PACED_BY_DEVICE):
            self.leave_out(step, "the device does not declare that it paces (bit 0 of register 3)")
        elif (session := self.arm(schema.PACED_BY_DEVICE, watchdog, parts=parts)) is None:
            self.leave_out(step, "the device did not arm")
        return session
