"""Bytes in, bytes out with the faults of a script in them, and when: without a port and without a clock.

The same bytes at the same times make the same faults. A carrier brings the bytes and the time, in seconds from any
beginning, and asks `next_s` when to call again although nothing comes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

from firmware_protocol import schema
from hapsim.bringup.capture import Capture, Decoded
from hapsim.bringup.faults.fault import POSITIONS, Effect, Moment, Piece, tidy
from hapsim.bringup.faults.script import Script
from hapsim.bringup.faults.witness import Witness

LONGEST = 512
"""Bytes that are kept without a delimiter among them, far more than a frame has: then they pass as they are."""


class Passed(NamedTuple):
    """Bytes that leave."""

    due_s: float
    """When, by the carrier's clock; never before what went the same way before."""
    to_device: bool
    data: bytes


@dataclass
class Traffic:
    """What passed in one direction. A damaged frame does not count as a frame."""

    frames_in: int = 0
    bytes_in: int = 0
    frames_out: int = 0
    bytes_out: int = 0


class Happened(NamedTuple):
    """A fault of the script, and how often it happened."""

    place: int
    """In the script, from 1 on."""
    kind: str
    when: str
    """When it begins, in words."""
    times: int
    counted: str
    """What `times` counts, in words."""


class Splitter:
    """Cuts the bytes of one direction into pieces, however they arrive: the same bytes make the same pieces."""

    def __init__(self, to_device: bool) -> None:
        self._capture = Capture((to_device,))
        self._to_device = to_device
        self._waiting = b""

    def split(self, data: bytes) -> Iterator[Piece]:
        """Yields every piece that ends in `data`. The rest waits for its delimiter."""
        self._waiting += data
        while self._waiting:
            end = self._waiting.find(0) + 1
            if end == 0 or end > LONGEST:
                if len(self._waiting) < LONGEST:
                    return
                end = LONGEST
            piece, self._waiting = self._waiting[:end], self._waiting[end:]
            last = deque(self._capture.feed(piece), maxlen=1)
            frames = [one for one in last if isinstance(one, Decoded) and len(one.data) < len(piece)]
            yield Piece(piece, self._to_device, frames[0] if frames else None)


class Injector:
    """The faults of a script, between a host and a device."""

    def __init__(self, script: Script, seed: int | None = None) -> None:
        """`seed` replaces the script's."""
        seed = script.seed if seed is None else seed
        self._faults = script.faults
        self._effects: list[Effect] = [
            fault.effect(f"{seed} {at} {fault.kind}") for at, fault in enumerate(script.faults)
        ]
        self._splitters = {to_device: Splitter(to_device) for to_device in (False, True)}
        self._latest_s = {False: -math.inf, True: -math.inf}
        self._begun_s: float | None = None
        self._number = -1
        self._under_way: deque[tuple[Piece, float]] = deque()
        self.samples = -1
        """Of the device, since its first position; -1 before that."""
        self.first_fault_s: float | None = None
        """When the first fault happened, by the carrier's clock; None if none did."""
        self.witness = Witness()
        """What the device said and what reached it, on its own side of the faults."""
        self.passed = {to_device: Traffic() for to_device in (False, True)}
        """What came in and what left, each way."""
        self.plugged = True
        """Whether the device is plugged in, as the host sees it."""

    @property
    def counts(self) -> list[tuple[str, int]]:
        """Each fault of the script, and how often it happened."""
        return [(fault.kind, effect.count) for fault, effect in zip(self._faults, self._effects, strict=True)]

    @property
    def happened(self) -> list[Happened]:
        """The same, with the place of each in the script, when it begins, and what is counted."""
        return [
            Happened(at, fault.kind, fault.when(), effect.count, fault.counted)
            for at, (fault, effect) in enumerate(zip(self._faults, self._effects, strict=True), start=1)
        ]

    def take(self, data: bytes, to_device: bool, time_s: float) -> list[Passed]:
        """Returns what leaves when bytes come in, and what time brings; in the order in which it leaves."""
        if self._begun_s is None:
            self._begun_s = time_s
        passed = self.advance(time_s)
        self.passed[to_device].bytes_in += len(data)
        for piece in self._splitters[to_device].split(data):
            self.passed[to_device].frames_in += piece.found is not None
            if not to_device:
                self._count_samples(piece)
                self.witness.hear(piece, time_s, self.samples)
            passed += self.advance(time_s)
            passed += self._through([piece], 0, time_s)
        self._arrive(time_s)
        return passed

    def advance(self, time_s: float) -> list[Passed]:
        """Returns what leaves although nothing comes in."""
        if self._begun_s is None:
            return []
        self._arrive(time_s)
        now, passed = self._moment(time_s), list[Passed]()
        for at, effect in enumerate(self._effects):
            passed += self._through(effect.pass_time(now), at + 1, time_s)
            if effect.plugs is not None:
                self.plugged, effect.plugs = effect.plugs, None
        self._note_first(time_s)
        return passed

    def next_s(self, time_s: float) -> float:
        """Returns when to call `advance` although nothing comes in, by the carrier's clock; infinity if never."""
        if self._begun_s is None:
            return math.inf
        now = self._moment(time_s)
        return self._begun_s + min((effect.next_s(now) for effect in self._effects), default=math.inf)

    def _moment(self, time_s: float) -> Moment:
        return Moment(tidy(time_s - (self._begun_s or 0.0)), self.samples)

    def _through(self, pieces: list[Piece], first: int, time_s: float) -> list[Passed]:
        """Passes pieces through the effects from `first` on."""
        if not pieces:
            return []
        now = self._moment(time_s)
        for effect in self._effects[first:]:
            pieces = [after for before in pieces for after in effect.take(before, now)]
        self._note_first(time_s)
        return list(self._leave(pieces, time_s))

    def _leave(self, pieces: Iterable[Piece], time_s: float) -> Iterator[Passed]:
        for piece in pieces:
            if not self.plugged or not piece.data:
                continue
            due_s = max(time_s + piece.delay_s, self._latest_s[piece.to_device])
            self._latest_s[piece.to_device] = due_s
            traffic = self.passed[piece.to_device]
            traffic.frames_out += piece.found is not None
            traffic.bytes_out += len(piece.data)
            if piece.to_device and piece.found is not None:
                self._under_way.append((piece, due_s))
            yield Passed(due_s, piece.to_device, piece.data)

    def _arrive(self, time_s: float) -> None:
        """Shows the witness what has reached the device by now."""
        while self._under_way and self._under_way[0][1] <= time_s:
            piece, due_s = self._under_way.popleft()
            self.witness.see(piece, due_s, self.samples)

    def _note_first(self, time_s: float) -> None:
        if self.first_fault_s is None and any(effect.count for effect in self._effects):
            self.first_fault_s = time_s
            self.witness.begin_fault(time_s)

    def _count_samples(self, piece: Piece) -> None:
        """Counts as the device does, over every arming."""
        frame = piece.frame
        if frame is None:
            return
        if frame.type == schema.STATUS:
            self._number = -1
        elif frame.type in POSITIONS:
            gap = (frame.number - self._number) % schema.SAMPLE_MODULUS
            if gap < schema.SAMPLE_MODULUS // 2:  # else it is one of the past
                self.samples += gap
                self._number = frame.number
