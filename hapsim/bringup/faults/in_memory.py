"""Faults around a transport in memory, in virtual time: for the mock that answers within `send`.

Time advances by the device's samples, one period each, and by what the host waits. While the host waits for something
that is held up, time jumps to when that is due.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from hapsim.bringup.faults.injector import Injector, Passed
from hapsim.loop.endings import HUNG_UP, TIMED_OUT
from hapsim.loop.transport import PythonTransport


def in_memory(injector: Injector, period_s: float) -> Callable[[PythonTransport], InMemory]:
    """Returns a wrapper of the transport, for `hapsim.running.start(scene, between=…)`. `period_s`: sample period."""
    return lambda device: InMemory(device, injector, period_s)


class InMemory:
    """A `PythonTransport` with faults in it."""

    def __init__(self, device: PythonTransport, injector: Injector, period_s: float) -> None:
        self._device, self._injector, self._period_s = device, injector, period_s
        self._queued: dict[bool, deque[Passed]] = {False: deque(), True: deque()}
        self._now_s = 0.0
        self._buffer = np.zeros(8192, np.uint8)

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Returns how many bytes there are for the host; TIMED_OUT after the timeout, HUNG_UP while unplugged."""
        until_s = self._now_s + max(timeout_ns, 0) * 1e-9
        while True:
            self._queue(self._injector.advance(self._now_s))
            code = self._bring_on()
            if not self._injector.plugged:
                return HUNG_UP
            if taken := self._take_due(buffer):
                return taken
            if code < 0:
                return code
            due = [queue[0].due_s for queue in self._queued.values() if queue]
            next_s = min([self._injector.next_s(self._now_s), *due])
            self._now_s = max(self._now_s, min(next_s, until_s))
            if next_s > until_s:
                time.sleep(max(timeout_ns, 0) * 1e-9)  # the host waits by its own clock
                return TIMED_OUT

    def send(self, frame: bytes) -> int:
        """Returns 0, or HUNG_UP."""
        self._queue(self._injector.take(frame, True, self._now_s))
        self._bring_on()
        return 0 if self._injector.plugged else HUNG_UP

    def _queue(self, passed: list[Passed]) -> None:
        for one in passed:
            self._queued[one.to_device].append(one)

    def _bring_on(self) -> int:
        """Gives the device everything that is due, and takes everything that it answers. Returns 0, or its code."""
        waiting = self._queued[True]
        while True:
            while waiting and waiting[0].due_s <= self._now_s:
                if (code := self._device.send(waiting.popleft().data)) < 0:
                    return code
            count = self._device.receive(self._buffer, 0)
            if count <= 0:
                return count
            before = self._injector.samples
            self._queue(self._injector.take(self._buffer[:count].tobytes(), False, self._now_s))
            self._now_s += (self._injector.samples - before) * self._period_s

    def _take_due(self, buffer: NDArray[np.uint8]) -> int:
        """Fills the buffer with bytes for the host that are due; returns how many."""
        queue, data = self._queued[False], b""
        while queue and queue[0].due_s <= self._now_s and len(data) < buffer.size:
            first, room = queue.popleft(), buffer.size - len(data)
            data += first.data[:room]
            if first.data[room:]:
                queue.appendleft(first._replace(data=first.data[room:]))
        buffer[: len(data)] = np.frombuffer(data, np.uint8)
        return len(data)
