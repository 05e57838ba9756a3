"""Record of the forces on the device's side of the faults: each one, its change, and how the last one ended.

The witness decodes like a receiver and judges nothing. A force does not count while the device is not armed, or after a
DISARM. A force older than its time to live counts as received, but has no effect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.capture import Registers
from firmware_protocol.decoder import Frame
from hapsim.bringup.faults.fault import Piece

_LOCKSTEP_S = 10.0  # PROTOCOL.md, section 7


@dataclass
class Forces:
    """Forces that reached the device. N; NaN if the device did not describe its scales."""

    DOCUMENT: ClassVar[str] = "count largest_N=largest largest_change_N=largest_change"

    count: int = 0
    largest: float = 0.0
    largest_change: float = 0.0
    """Largest change from the force that a device holds by PROTOCOL.md, section 6: the force before, or zero at arming
    and after its time to live. The release does not count as a change."""


@dataclass(frozen=True)
class Release:
    """End of the last force."""

    by: str
    """disarm: a DISARM reached the device; device: it said by itself that it is not armed any more; time to live: what
    PROTOCOL.md, section 6, makes a device do that got no further force; lockstep: the same if no time passes while the
    host is quiet, after 10 s."""
    after_last_force_s: float
    after_last_force_samples: int | None
    """Samples that the device sent between the last force and its release; None if its time to live ended it."""
    after_first_fault_s: float | None
    confirmed: bool
    """True if the device reported, then or later, that it is no longer armed."""


class _Last(NamedTuple):
    """The last force that the device acted on."""

    newtons: NDArray[np.float64]
    time_s: float
    """Time of arrival."""
    sample: int
    """Sample of arrival."""
    answered: int
    """The sample that it answers."""
    lives: int
    """Samples."""


class Witness:
    """Sees frames, and keeps what matters of them."""

    def __init__(self) -> None:
        self.all, self.since_fault = Forces(), Forces()
        self.samples = -1
        self.fault_s: float | None = None
        """Time of the first fault. Forces from then on also count in `since_fault`."""
        self._described = Registers()
        self._is_first = True  # no force since arming
        self._held: NDArray[np.float64] = np.zeros(1)  # what the device puts out in this sample, N
        self._pacing = schema.PACED_BY_DEVICE
        self._number: int | None = None  # of the newest position
        self._last: _Last | None = None
        self._armed = True  # unless it was heard to be something else
        self._confirmed = False
        self._ended: tuple[str, float, int] | None = None  # by what, when, at which sample

    def receive(self, piece: Piece, time_s: float, samples: int) -> None:
        """Takes in a frame that the device sends, `samples` after its first."""
        self.samples = samples
        frame = piece.frame
        if frame is None:
            return
        self._described.note(frame)
        if frame.type == schema.STATUS:
            self._armed = frame.counts[0] & 0xFF == schema.ARMED
            self._number, self._is_first = None, True
            if not self._armed:
                self._confirmed = True
                self._end("device", time_s)
        elif frame.type in schema.POSITIONS:
            self._number = frame.number

    def see(self, piece: Piece, time_s: float, samples: int) -> None:
        """Takes in a frame that reaches the device, `samples` after its first."""
        self.samples = samples
        frame = piece.frame
        if frame is None:
            return
        if frame.type == schema.ARM:
            self._ended = None
            self._pacing = frame.argument & ~schema.PART_BITS
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
        since_fault = None if self.fault_s is None else end_s - self.fault_s
        return Release(by, end_s - last.time_s, samples, since_fault, self._confirmed)

    def _end(self, by: str, time_s: float) -> None:
        if self._last is not None and self._ended is None:
            self._ended = by, time_s, self.samples

    def _see_force(self, frame: Frame, time_s: float, samples: int) -> None:
        age = 0 if self._number is None else (self._number - frame.number) % schema.SAMPLE_MODULUS
        acts = age <= frame.argument
        counts = frame.counts[: self._described.get(schema.REG_CHANNELS)]  # without lines and commands
        scales = [self._described.scale(schema.REG_FORCE_SCALE, channel) for channel in range(len(counts))]
        newtons = np.array(counts) * np.array(scales, np.float64)  # NaN for None
        last = self._last
        replaces = self._pacing == schema.PACED_BY_DEVICE and last is not None and last.sample == samples
        if acts and (self._is_first or not replaces):  # one of two in a sample never acts
            over = self._is_first or last is None or self._is_over(last, time_s, samples)
            self._held = np.zeros_like(newtons) if over or last is None else last.newtons
        for forces in (self.all, self.since_fault) if self.fault_s is not None else (self.all,):
            forces.count += 1
            if acts:
                forces.largest = float(np.maximum(forces.largest, np.abs(newtons).max()))
                change = np.abs(newtons - self._held).max()
                forces.largest_change = float(np.maximum(forces.largest_change, change))
        if acts:
            self._last, self._is_first = _Last(newtons, time_s, samples, samples - age, frame.argument), False
            self._ended, self._confirmed = None, False

    def _is_over(self, last: _Last, time_s: float, samples: int) -> bool:
        """Returns whether a force has expired, by the device's samples or, if the host paces, its clock."""
        if self._pacing == schema.PACED_BY_HOST:
            return time_s - last.time_s > (last.lives + 1) / self._rate()
        return samples - last.answered > last.lives + 1

    def _rate(self) -> float:
        """Returns Hz, as the device described it; NaN if it did not."""
        return self._described.number(schema.REG_RATE) or math.nan
