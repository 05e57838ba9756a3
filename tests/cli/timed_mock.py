"""A mock with a timer of its own, for a stand-in of pyserial.

It has no thread: its samples that have become due are taken whenever the host looks for bytes.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.device.mock.firmware import check_watchdog, prepare, take_bytes, take_sample
from hapsim.loop.clocks import next_point
from hapsim.loop.endings import TIMED_OUT

_LOOK_S = 1e-3  # longest sleep: systems differ in how late they end one


class TimedMock:
    """Transport of a host to a MOCK in the same program."""

    def __init__(self, mock: Any) -> None:
        prepare(mock)
        self._mock = mock
        self._period_ns = round(float(mock.converters[0].period) * 1e9)
        self._due_ns = 0

    def send(self, frame: bytes) -> int:
        """Sends a frame. Returns 0."""
        was_ticking, now = self._is_ticking, time.monotonic_ns()
        take_bytes(self._mock, np.frombuffer(frame, np.uint8).copy(), len(frame), now)
        if self._is_ticking and not was_ticking:
            self._due_ns = now + self._period_ns
        return 0

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Waits for bytes of the mock. Returns their count, or TIMED_OUT."""
        give_up = time.monotonic_ns() + timeout_ns
        while True:
            now = time.monotonic_ns()
            if self._is_ticking and now >= self._due_ns:
                take_sample(self._mock, now)
                self._due_ns, _ = next_point(self._due_ns, now, self._period_ns)
            check_watchdog(self._mock, now)
            if count := self._fetch(buffer):
                return count
            if now >= give_up:
                return TIMED_OUT
            until = min(give_up, self._due_ns) if self._is_ticking else give_up
            time.sleep(min(max(until - time.monotonic_ns(), 0) * 1e-9, _LOOK_S))

    @property
    def _is_ticking(self) -> bool:
        board = self._mock.board
        return bool(board.state == schema.ARMED and board.pacing == schema.PACED_BY_DEVICE)

    def _fetch(self, buffer: NDArray[np.uint8]) -> int:
        """Moves the waiting bytes to the buffer, as many as it takes. Returns their count."""
        waiting = int(self._mock.board.out)
        count = min(waiting, buffer.size)
        buffer[:count] = self._mock.outbox[:count]
        self._mock.outbox[: waiting - count] = self._mock.outbox[count:waiting].copy()
        self._mock.board.out = waiting - count
        return count
