"""What a device got, on its own side of the faults: every force, how far one was from what the device held, and when
the last of them was over. It decodes what a receiver would decode, and judges nothing. A force that comes when the
device said that it is not armed, or got a DISARM, is none; one that is older than its time to live came, and does
nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from firmware_protocol import schema
from firmware_protocol.decoder import Frame
from hapsim.bringup.capture import Capture
from hapsim.bringup.faults.piece import Piece

_LOCKSTEP_S = 10.0  # PROTOCOL.md, section 7


@dataclass
class Forces:
    """Of the forces that reached the device. N; NaN where the device did not describe its scales."""

    count: int = 0
    largest: float = 0.0
    largest_change: float = 0.0
    """From what a device holds that keeps PROTOCOL.md, section 6: the force before, zero at arming and once its time to
    live is over. The release is none."""


@dataclass(frozen=True)
class Release:
    """How the last force ended."""

    by: str
    """disarm: a DISARM reached the device; device: it said by itself that it is not armed any more; time to live: what
    PROTOCOL.md, section 6, makes a device do that got no further force; lockstep: the same where no time passes while
    the host is quiet, after 10 s."""
    after_last_force_s: float
    after_last_force_samples: int | None
    """Of the device's samples that were sent meanwhile; None where it is the time to live that ended it."""
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
        self._described = Capture((False,))
        self._scale: list[float] | None = None  # of each channel's force, N; None: to be looked up
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
        """A frame that the device sends, `samples` after its first."""
        self.samples = samples
        if piece.found is None:
            return
        frame = piece.found.frame
        if frame.type == schema.DESCRIPTION:
            self._described.registers[frame.number] = frame.counts[0] & 0xFFFFFFFF
            self._scale = None
        elif frame.type == schema.STATUS:
            self._armed = frame.counts[0] & 0xFF == schema.ARMED
            self._number = None
            self._before = []
            if not self._armed:
                self._confirmed = True
                self._end("device", time_s)
        elif frame.type in (schema.POSITION, schema.POSITION_HELD):
            self._number = frame.number

    def see(self, piece: Piece, time_s: float, samples: int) -> None:
        """A frame that reaches the device, `samples` after its first."""
        self.samples = samples
        if piece.found is None:
            return
        frame = piece.found.frame
        if frame.type == schema.ARM:
            self._ended = None
            self._pacing = frame.argument & (schema.WITH_VELOCITY - 1)
        elif frame.type == schema.DISARM:
            self._armed = False
            self._end("disarm", time_s)
        elif frame.type == schema.FORCE and self._armed:
            self._see_force(frame, time_s, samples)

    def release(self) -> Release | None:
        """How the last force ended; None where none reached the device."""
        if self._last is None:
            return None
        last = self._last
        lockstep = self._pacing == schema.LOCKSTEP
        over_s = last.time_s + (_LOCKSTEP_S if lockstep else (last.lives + 2) / self._rate())
        ended = self._ended
        if ended is None or over_s < ended[1]:
            by = "lockstep" if lockstep else "time to live"
            return Release(by, over_s - last.time_s, None, self._since_fault(over_s), self._confirmed)
        by, ended_s, sample = ended
        return Release(by, ended_s - last.time_s, sample - last.sample, self._since_fault(ended_s), self._confirmed)

    def _since_fault(self, time_s: float) -> float | None:
        return None if self._fault_s is None else time_s - self._fault_s

    def _end(self, by: str, time_s: float) -> None:
        if self._last is not None and self._ended is None:
            self._ended = by, time_s, self.samples

    def _scales(self) -> list[float]:
        if self._scale is None:
            scales = [self._described.scale(schema.REG_FORCE_SCALE, channel) for channel in range(schema.MAX_CHANNELS)]
            self._scale = [math.nan if scale is None else scale for scale in scales]
        return self._scale

    def _see_force(self, frame: Frame, time_s: float, samples: int) -> None:
        age = 0 if self._number is None else (self._number - frame.number) % schema.SAMPLE_MODULUS
        kept = (self.all, self.since_fault) if self._fault_s is not None else (self.all,)
        for forces in kept:
            forces.count += 1
        if age > frame.argument:
            return
        force = [scale * count for scale, count in zip(self._scales(), frame.counts, strict=False)]
        if not self._is_overtaken(samples):
            over = not self._before or self._is_over(time_s, samples)
            self._held = [0.0] * len(force) if over else self._before
        change = max((abs(a - b) for a, b in zip(force, self._held, strict=False)), default=0.0)
        for forces in kept:
            forces.largest = _larger(forces.largest, max(map(abs, force)))
            forces.largest_change = _larger(forces.largest_change, change)
        self._before, self._last, self._ended = force, _Last(time_s, samples, samples - age, frame.argument), None
        self._confirmed = False

    def _is_overtaken(self, samples: int) -> bool:
        """Whether the force before never acts: another one comes in the same sample of a device that paces itself."""
        paces = self._pacing == schema.PACED_BY_DEVICE
        return paces and self._before != [] and self._last is not None and self._last.sample == samples

    def _is_over(self, time_s: float, samples: int) -> bool:
        """Whether the last force has no more time to live, by the device's samples or, where the host paces, its
        clock."""
        last = self._last
        if last is None:
            return True
        if self._pacing == schema.PACED_BY_HOST:
            return time_s - last.time_s > (last.lives + 1) / self._rate()
        return samples - last.answered > last.lives + 1

    def _rate(self) -> float:
        """Hz, as the device described it."""
        return self._described.number(schema.REG_RATE) or math.nan


def _larger(one: float, other: float) -> float:
    return math.nan if math.isnan(one) or math.isnan(other) else max(one, other)
