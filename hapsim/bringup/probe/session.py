"""One arming: the positions that came, what was answered, and how it ended."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from firmware_protocol import schema
from hapsim.bringup.probe.wire import ANSWER_S, ARMED, SET_UP, WITH_VELOCITIES, Heard, Wire

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
        """DISARM in the armed format: the STATUS that answers, None where none does. Every position before it is
        taken."""
        self.wire.send(self.wire.frame(schema.DISARM, 0, armed=True))
        answer, heard = self.wire.wait_for(_is_idle, 4 * ANSWER_S)
        self.take(heard)
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
