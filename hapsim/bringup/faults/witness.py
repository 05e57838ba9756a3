"""What a device got, on its own side of the faults: every force, how far each was from the one that the device held,
and how the last one ended.

It decodes what a receiver would decode, and judges nothing. A force that comes while the device is not armed, or after
a DISARM, does not count; one that is older than its time to live counts as received, but does nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from firmware_protocol import schema
from firmware_protocol.decoder import Frame
from hapsim.bringup.capture import Registers
from hapsim.bringup.faults.fault import POSITIONS, Piece

_LOCKSTEP_S = 10.0  # PROTOCOL.md, section 7


@dataclass
class Forces:
    """Of the forces that reached the device. N; NaN if the device did not describe its scales."""

    count: int = 0
    largest: float = 0.0
    largest_change: float = 0.0
    """From what a device holds that keeps PROTOCOL.md, section 6: the force before, zero at arming and once its time to
    live is over. The release does not count as a change."""

    def add(self, largest: float, change: float) -> None:
        """Takes in a force that acts."""
        self.largest = _larger(self.largest, largest)
        self.largest_change = _larger(self.largest_change, change)


@dataclass(frozen=True)
class Release:
    """How the last force ended."""

    by: str
    """disarm: a DISARM reached the device; device: it said by itself that it is not armed any more; time to live: what
    PROTOCOL.md, section 6, makes a device do that got no further force; lockstep: the same where no time passes while
    the host is quiet, after 10 s."""
    after_last_force_s: float
    after_last_force_samples: int | None
    """Of the device's samples that were sent meanwhile; None if its time to live ended it."""
    after_first_fault_s: float | None
    confirmed: bool
    """Whether the device said, then or later, that it is not armed any more."""


class _Last(NamedTuple):
    """The last force that the device acted on: when it came, by the clock and in samples, which sample it answers, and
    for how many samples it lives."""

    time_s: float
    sample: int
    answered: int
    lives: int


class Witness:
    """Sees frames, and keeps what matters of them."""

    def __init__(self) -> None:
        self.all, self.since_fault = Forces(), Forces()
        self.samples = -1
        self._described = Registers()
        self._before: list[float] = []  # the force before, N; empty: none since arming
        self._held: list[float] = []  # what the device puts out in this sample, N
        self._pacing = schema.PACED_BY_DEVICE
        self._number: int | None = None  # of the newest position
        self._fault_s: float | None = None
        self._last: _Last | None = None
        self._armed = True  # unless it was heard to be something else
        self._confirmed = False
        self._ended: tuple[str, float, int] | None = None  # by what, when, at which sample

    def begin_fault(self, time_s: float) -> None:
        """From here on forces count as `since_fault` too."""
        self._fault_s = time_s

    def hear(self, piece: Piece, time_s: float, samples: int) -> None:
        """Takes in a frame that the device sends, `samples` after its first."""
        self.samples = samples
        frame = piece.frame
        if frame is None:
            return
        self._described.note(frame)
        if frame.type == schema.STATUS:
            self._armed = frame.counts[0] & 0xFF == schema.ARMED
            self._number, self._before = None, []
            if not self._armed:
                self._confirmed = True
                self._end("device", time_s)
        elif frame.type in POSITIONS:
            self._number = frame.number

    def see(self, piece: Piece, time_s: float, samples: int) -> None:
        """Takes in a frame that reaches the device, `samples` after its first."""
        self.samples = samples
        frame = piece.frame
        if frame is None:
            return
        if frame.type == schema.ARM:
            self._ended = None
            self._pacing = frame.argument & (schema.WITH_VELOCITY - 1)
        elif frame.type == schema.DISARM:
            self._armed = False
            self._end("disarm", time_s)
        elif frame.type == schema.FORCE and self._armed:
            self._see_force(frame, time_s, samples)

    def release(self) -> Release | None:
        """Returns how the last force ended; None if none reached the device."""
        if self._last is None:
            return None
        last, ended = self._last, self._ended
        lockstep = self._pacing == schema.LOCKSTEP
        over_s = last.time_s + (_LOCKSTEP_S if lockstep else (last.lives + 2) / self._rate())
        if ended is None or over_s < ended[1]:
            by, end_s, samples = "lockstep" if lockstep else "time to live", over_s, None
        else:
            by, end_s, samples = ended[0], ended[1], ended[2] - last.sample
        since_fault = None if self._fault_s is None else end_s - self._fault_s
        return Release(by, end_s - last.time_s, samples, since_fault, self._confirmed)

    def _end(self, by: str, time_s: float) -> None:
        if self._last is not None and self._ended is None:
            self._ended = by, time_s, self.samples

    def _see_force(self, frame: Frame, time_s: float, samples: int) -> None:
        age = 0 if self._number is None else (self._number - frame.number) % schema.SAMPLE_MODULUS
        kept = (self.all, self.since_fault) if self._fault_s is not None else (self.all,)
        for forces in kept:
            forces.count += 1
        if age > frame.argument:
            return
        scales = [self._described.scale(schema.REG_FORCE_SCALE, channel) for channel in range(len(frame.counts))]
        force = [
            math.nan if scale is None else scale * count for scale, count in zip(scales, frame.counts, strict=True)
        ]
        if not self._replaces_one_that_never_acts(samples):
            over = not self._before or self._is_over(time_s, samples)
            self._held = [0.0] * len(force) if over else self._before
        change = max((abs(a - b) for a, b in zip(force, self._held, strict=False)), default=0.0)
        for forces in kept:
            forces.add(max(map(abs, force)), change)
        self._before, self._last, self._ended = force, _Last(time_s, samples, samples - age, frame.argument), None
        self._confirmed = False

    def _replaces_one_that_never_acts(self, samples: int) -> bool:
        """Returns whether the force before came in the same sample of a device that paces itself."""
        paces = self._pacing == schema.PACED_BY_DEVICE
        return paces and self._before != [] and self._last is not None and self._last.sample == samples

    def _is_over(self, time_s: float, samples: int) -> bool:
        """Returns whether the last force has no more time to live, by the device's samples or, where the host paces,
        its clock."""
        last = self._last
        if last is None:
            return True
        if self._pacing == schema.PACED_BY_HOST:
            return time_s - last.time_s > (last.lives + 1) / self._rate()
        return samples - last.answered > last.lives + 1

    def _rate(self) -> float:
        """Returns Hz, as the device described it; NaN if it did not."""
        return self._described.number(schema.REG_RATE) or math.nan


def _larger(one: float, other: float) -> float:
    return math.nan if math.isnan(one) or math.isnan(other) else max(one, other)
