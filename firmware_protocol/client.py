"""The host's side of the wire outside of a loop: what a frame is, how to send one, and how to wait for an answer.

A subclass carries the bytes and decides which formats are read: `send` and `receive`.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

from firmware_protocol import schema
from firmware_protocol.description import Description
from firmware_protocol.frames import SETUP, Format, armed_format, every_armed_format, frame_to_device

ANSWER_S = 0.25
"""Timeout of one answer (PROTOCOL.md, section 8)."""

TRIES = 4
"""Attempts to ask a device that has answered before."""

FIRST_TRIES = 12
"""Attempts to ask at first, three seconds: a board that resets when its port opens needs them."""

RELEASE_S = 0.1
"""Timeout of the answer to a DISARM."""


class Received(NamedTuple):
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
        """State in a STATUS."""
        return self.word & 0xFF

    @property
    def fault(self) -> int:
        """Fault in a STATUS."""
        return self.word >> 8 & 0xFF


class Client(ABC):
    """A host that speaks with one device. It sends nothing by itself."""

    clock: Any = time
    """Has `monotonic` and `sleep`, as the module `time` has; a test plays devices in virtual time."""

    armed: Format = armed_format(1)
    """The format of an armed device's frames."""

    @abstractmethod
    def send(self, frame: bytes) -> None:
        """Sends a frame. Raises the subclass's error if the port does not take it."""

    @abstractmethod
    def receive(self, timeout_s: float) -> list[Received]:
        """Returns frames among the bytes that come next, after at most this time. Raises the subclass's error if the
        port is gone."""

    def frame(
        self, kind: int, number: int, argument: int = 0, counts: Sequence[int] = (0,), armed: bool = False
    ) -> bytes:
        """Returns a frame of the host's, filled up with zeros; `armed`: in the armed format."""
        wire = self.armed if armed else SETUP
        words = wire.words(to_device=True)
        padded = [*counts, *[0] * words][:words]
        if kind == schema.FORCE:  # only a sample's number begins anew
            number %= schema.SAMPLE_MODULUS
        return frame_to_device(wire, kind, number, argument, padded)

    def arm_frame(self, pacing: int, watchdog: int, *, parts: int = 0, word: int = schema.SCHEMA_HASH) -> bytes:
        """Returns ARM; `watchdog`: samples, `parts`: bits of schema.PARTS, `word`: its schema hash."""
        signed = (word & 0xFFFFFFFF) - ((word & 0x80000000) << 1)
        return self.frame(schema.ARM, watchdog, pacing | parts, [signed])

    def wait_for(self, fits: Callable[[Received], bool], seconds: float) -> tuple[Received | None, list[Received]]:
        """Returns the first frame that `fits`, None if none comes within this time; and every frame until then, and
        those that came with it."""
        received: list[Received] = []
        end = self.clock.monotonic() + seconds
        while (left := end - self.clock.monotonic()) > 0:
            new = self.receive(left)
            received += new
            fitting = next(filter(fits, new), None)
            if fitting is not None:
                return fitting, received
        return None, received

    def receive_for(self, seconds: float) -> list[Received]:
        """Returns every frame that comes within this time."""
        return self.wait_for(lambda _: False, seconds)[1]

    def ask(
        self,
        frame: bytes,
        kind: int,
        number: int | None = None,
        *,
        tries: int = TRIES,
        after_quiet: bytes = b"",
        fits: Callable[[Received], bool] = lambda _: True,
    ) -> tuple[Received | None, list[Received]]:
        """Sends a frame up to `tries` times, until one of this kind and number (None: any) answers that `fits`, and
        `after_quiet` before the third time. Returns the answer (None if none comes), and every frame."""
        received: list[Received] = []
        for attempt in range(tries):
            if attempt == 2 and after_quiet:
                self.send(after_quiet)
            self.send(frame)
            answer, new = self.wait_for(
                lambda one: one.kind == kind and number in (None, one.number) and fits(one), ANSWER_S
            )
            received += new
            if answer is not None:
                return answer, received
        return None, received

    def register(self, number: int, tries: int = TRIES, after_quiet: bytes = b"") -> int | None:
        """Returns what DESCRIBE of a register is answered with, unsigned; None if it is not."""
        frame = self.frame(schema.DESCRIBE, number)
        answer, _ = self.ask(frame, schema.DESCRIPTION, number, tries=tries, after_quiet=after_quiet)
        return None if answer is None else answer.word

    def arm(
        self,
        device: Description,
        pacing: int,
        watchdog: int,
        *,
        parts: int = 0,
        fits: Callable[[Received], bool] = lambda _: True,
    ) -> tuple[Received | None, list[Received]]:
        """Sends ARM until a STATUS that `fits` answers. Returns that (None if none comes), and every frame."""
        self.armed = armed_format(device.channels, parts)
        return self.ask(self.arm_frame(pacing, watchdog, parts=parts), schema.STATUS, fits=fits)

    def release(
        self,
        repeats: int = 3,
        states: Sequence[int] = (schema.IDLE,),
        patience_s: Callable[[], float] = lambda: RELEASE_S,
    ) -> Received | None:
        """Disarms in both formats in which the device may listen, `repeats` times each, until a STATUS says one of
        `states`; returns that, None if there was none. `patience_s`: returns the wait for each answer."""
        for armed in (True, False) * repeats:
            self.send(self.frame(schema.DISARM, 0, armed=armed))
            answer, _ = self.wait_for(lambda one: one.kind == schema.STATUS and one.state in states, patience_s())
            if answer is not None:
                return answer
        return None


@cache
def disarm_in_every_format() -> bytes:
    """Returns the frames that release a device armed by another host, with any number of channels and any sensed parts.
    A device that follows lines is released by its watchdog: its frames would double the bytes."""
    sensing = [wire for wire in every_armed_format() if not schema.in_parts(wire.parts, to_device=True)]
    return b"".join(frame_to_device(wire, schema.DISARM, 0, 0, [0] * wire.channels) for wire in sensing)
