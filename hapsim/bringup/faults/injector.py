"""Bytes in, bytes out with the faults of a script in them, and when: pure, without a port and without a clock.

The same bytes at the same times make the same faults. Whoever carries the bytes tells the time, in seconds from any
beginning, and asks `next_s` when to call again although nothing comes.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from firmware_protocol import schema
from hapsim.bringup.faults.fault import Effect
from hapsim.bringup.faults.piece import Moment, Piece, Splitter, tidy
from hapsim.bringup.faults.script import Script
from hapsim.bringup.faults.witness import Witness

_MOVING = (schema.POSITION, schema.POSITION_HELD)


class Passed(NamedTuple):
    """Bytes that leave."""

    due_s: float
    """When, by the clock of whoever carries them; never before what went the same way before."""
    to_device: bool
    data: bytes


@dataclass
class Traffic:
    """What passed in one direction. A frame that was damaged is none."""

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
    """When it is to begin, in words."""
    times: int
    counted: str
    """What `times` counts, in words."""


class Injector:
    """The faults of a script, between a host and a device."""

    def __init__(self, script: Script, seed: int | None = None) -> None:
        """`seed`: in place of the script's."""
        self._seed = script.seed if seed is None else seed
        self._faults = script.faults
        self._effects: list[Effect] = [
            fault.effect(f"{self._seed} {at} {fault.kind}") for at, fault in enumerate(script.faults)
        ]
        self._splitters = {to_device: Splitter(to_device) for to_device in (False, True)}
        self._latest_s = {False: -math.inf, True: -math.inf}
        self._begun_s: float | None = None
        self._first_fault_s: float | None = None
        self._samples, self._number = -1, -1
        self._under_way: deque[tuple[Piece, float]] = deque()
        self.witness = Witness()
        """What went to the device, and what it said, on its own side of the faults."""
        self.passed = {to_device: Traffic() for to_device in (False, True)}
        """What came in and what left, each way."""
        self.plugged = True
        """Whether the device is plugged in, as the host sees it."""

    @property
    def counts(self) -> list[tuple[str, int]]:
        """Each fault of the script, and how often it happened."""
        return [(fault.kind, fault.times) for fault in self.happened]

    @property
    def happened(self) -> list[Happened]:
        """The same, with the place of each in the script, when it is to begin, and what is counted."""
        return [
            Happened(at, fault.kind, fault.when(), effect.count, fault.counted)
            for at, (fault, effect) in enumerate(zip(self._faults, self._effects, strict=True), start=1)
        ]

    @property
    def samples(self) -> int:
        """Of the device, since its first position; -1 before that."""
        return self._samples

    @property
    def first_fault_s(self) -> float | None:
        """When the first of them happened, by the carrier's clock; None: none did."""
        return self._first_fault_s

    def take(self, data: bytes, to_device: bool, time_s: float) -> list[Passed]:
        """What becomes of bytes that come in now, and of what time brings; in the order in which it leaves."""
        if self._begun_s is None:
            self._begun_s = time_s
        passed = self.advance(time_s)
        self.passed[to_device].bytes_in += len(data)
        for piece in self._splitters[to_device].split(data):
            self.passed[to_device].frames_in += piece.found is not None
            if not to_device:
                self._count_samples(piece)
                self.witness.hear(piece, time_s, self._samples)
            passed += self.advance(time_s)
            passed += self._through(piece, 0, time_s)
        self._arrive(time_s)
        return passed

    def advance(self, time_s: float) -> list[Passed]:
        """What time brings although nothing comes in."""
        if self._begun_s is None:
            return []
        self._arrive(time_s)
        now, passed = self._moment(time_s), list[Passed]()
        for at, effect in enumerate(self._effects):
            for piece in effect.pass_time(now):
                passed += self._through(piece, at + 1, time_s)
            if effect.plugs is not None:
                self.plugged, effect.plugs = effect.plugs, None
        self._note_first(time_s)
        return passed

    def next_s(self, time_s: float) -> float:
        """When to call `advance` although nothing comes in, by the carrier's clock; infinite: not before bytes do."""
        if self._begun_s is None:
            return math.inf
        now = self._moment(time_s)
        return self._begun_s + min((effect.next_s(now) for effect in self._effects), default=math.inf)

    def _moment(self, time_s: float) -> Moment:
        return Moment(tidy(time_s - (self._begun_s or 0.0)), self._samples)

    def _through(self, piece: Piece, first: int, time_s: float) -> list[Passed]:
        """A piece through the effects from `first` on."""
        now, pieces = self._moment(time_s), [piece]
        for effect in self._effects[first:]:
            pieces = [after for before in pieces for after in effect.take(before, now)]
        self._note_first(time_s)
        return list(self._leaving(pieces, time_s))

    def _leaving(self, pieces: Iterable[Piece], time_s: float) -> Iterable[Passed]:
        for piece in pieces:
            if self.plugged and piece.data:
                due_s = max(time_s + piece.delay_s, self._latest_s[piece.to_device])
                self._latest_s[piece.to_device] = due_s
                self._note_leaving(piece, due_s)
                yield Passed(due_s, piece.to_device, piece.data)

    def _note_leaving(self, piece: Piece, due_s: float) -> None:
        traffic = self.passed[piece.to_device]
        traffic.frames_out += piece.found is not None
        traffic.bytes_out += len(piece.data)
        if piece.to_device and piece.found is not None:
            self._under_way.append((piece, due_s))

    def _arrive(self, time_s: float) -> None:
        """What is due reaches the device."""
        while self._under_way and self._under_way[0][1] <= time_s:
            piece, due_s = self._under_way.popleft()
            self.witness.see(piece, due_s, self._samples)

    def _note_first(self, time_s: float) -> None:
        if self._first_fault_s is None and any(effect.count for effect in self._effects):
            self._first_fault_s = time_s
            self.witness.begin_fault(time_s)

    def _count_samples(self, piece: Piece) -> None:
        """As the device counts them, over every arming."""
        if piece.found is None:
            return
        frame = piece.found.frame
        if frame.type == schema.STATUS:
            self._number = -1
        elif frame.type in _MOVING:
            gap = (frame.number - self._number) % schema.SAMPLE_MODULUS
            if gap < schema.SAMPLE_MODULUS // 2:  # else it is one of the past
                self._samples += gap
                self._number = frame.number
