"""What a device got, on its own side of the faults: every force, how far one was from the one before, and when the last
of them was over. It decodes what a receiver would decode, and judges nothing. A force that comes when the device said,
or was told, that it is not armed is none.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from firmware_protocol import schema
from hapsim.device.capture import Capture
from hapsim.faults.piece import Piece

_LOCKSTEP_S = 10.0  # PROTOCOL.md, section 7


@dataclass
class Forces:
    """Of the forces that reached the device. N; NaN where the device did not describe its scales."""

    count: int = 0
    largest: float = 0.0
    largest_change: float = 0.0
    """Between two that came one after the other while the device was armed; the release is none."""


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


class Witness:
    """Sees frames, and keeps what matters of them."""

    def __init__(self) -> None:
        self.all, self.since_fault = Forces(), Forces()
        self.samples = -1
        self._described = Capture((False,))
        self._scale: list[float] | None = None  # of each channel's force, N; None: to be looked up
        self._before: list[float] | None = None  # the force before, N
        self._fault_s: float | None = None
        self._lockstep = False
        self._last: tuple[float, int, int] | None = None  # when the last force came, in s and samples, and how it lives
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
            if not self._armed:
                self._confirmed = True
                self._end("device", time_s)

    def see(self, piece: Piece, time_s: float, samples: int) -> None:
        """A frame that reaches the device, `samples` after its first."""
        self.samples = samples
        if piece.found is None:
            return
        frame = piece.found.frame
        if frame.type == schema.ARM:
            self._before, self._ended = None, None
            self._lockstep = frame.argument & (schema.WITH_VELOCITY - 1) == schema.LOCKSTEP
        elif frame.type == schema.DISARM:
            self._armed = False
            self._end("disarm", time_s)
        elif frame.type == schema.FORCE and self._armed:
            self._see_force([scale * count for scale, count in zip(self._scales(), frame.counts, strict=False)])
            self._last, self._ended, self._confirmed = (time_s, samples, frame.argument), None, False

    def release(self) -> Release | None:
        """How the last force ended; None where none reached the device."""
        if self._last is None:
            return None
        last_s, last_sample, lives = self._last
        rate = self._described.number(schema.REG_RATE) or math.nan
        over_s = last_s + (_LOCKSTEP_S if self._lockstep else (lives + 2) / rate)
        ended = self._ended
        if ended is None or over_s < ended[1]:
            by = "lockstep" if self._lockstep else "time to live"
            return Release(by, over_s - last_s, None, self._since_fault(over_s), self._confirmed)
        by, ended_s, sample = ended
        return Release(by, ended_s - last_s, sample - last_sample, self._since_fault(ended_s), self._confirmed)

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

    def _see_force(self, force: list[float]) -> None:
        largest = max(map(abs, force))
        change = max((abs(a - b) for a, b in zip(force, self._before or force, strict=True)), default=0.0)
        for forces in (self.all, self.since_fault) if self._fault_s is not None else (self.all,):
            forces.count += 1
            forces.largest = _larger(forces.largest, largest)
            forces.largest_change = _larger(forces.largest_change, change)
        self._before = force


def _larger(one: float, other: float) -> float:
    return math.nan if math.isnan(one) or math.isnan(other) else max(one, other)
