"""A device of device.py with its host's clock and transport, in virtual time: for a probe, and as a port of a run."""

from __future__ import annotations

import contextlib
import random
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hapsim.device.connection import Connection
from hapsim.loop.endings import HUNG_UP, TIMED_OUT

sys.path.insert(0, str(Path(__file__).parent))
from device import Device

_ROOM = 20_480  # bytes that wait for the host, as on a pseudo-terminal
_WORK_S = 20e-6  # of the host, for each call


class VirtualLine:
    """A host's clock, transport and device in one: time passes where the host waits, and a little where it works.

    `late`: the share of answers that are late, the largest delay in s, and a seed.
    """

    def __init__(self, options: dict[str, Any]) -> None:
        self._time = 100.0
        self._to_host = b""
        self._gone = False
        self._random = random.Random(1)
        self.late = (0.1, 0.004)  # now and then, as a host in Python is
        self.device = Device(self._put, self.monotonic, options)

    def _put(self, data: bytes) -> int:
        count = min(len(data), _ROOM - len(self._to_host))
        self._to_host += data[:count]
        return count

    def monotonic(self) -> float:
        return self._time

    def sleep(self, seconds: float) -> None:
        self._pass_until(self._time + seconds, heard=False)

    def _pass_until(self, end: float, heard: bool) -> None:
        while self._time < end and not (heard and self._to_host):
            self._time = min(end, self._time + max(self.device.wait(), 1e-6))
            self.device.look()

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        if self._is_gone():
            return HUNG_UP
        self._pass_until(self._time + timeout_ns * 1e-9, heard=True)
        self._pass_until(self._time + _WORK_S, heard=False)
        data, self._to_host = self._to_host[: buffer.size], self._to_host[buffer.size :]
        buffer[: len(data)] = np.frombuffer(data, np.uint8)
        return len(data) or TIMED_OUT

    def _is_gone(self) -> bool:
        self._gone = self._gone or ("resets_where_it_waits" in self.device.faults and len(self._to_host) == _ROOM)
        return self._gone

    def send(self, frame: bytes) -> int:
        if self._is_gone():
            return HUNG_UP
        share, longest = self.late
        late = self._random.random() * longest if self._random.random() < share else 0.0
        self._pass_until(self._time + _WORK_S + late, heard=False)
        self.device.take(frame)
        self.device.look()
        return 0


PORT = "/dev/tty0virtual"


def virtual_port(patch: pytest.MonkeyPatch, **options: Any) -> Device:
    """Makes the name PORT lead to a device of these options, at its first sample, for runs with `portable=True`. Its
    time is the loop's too and passes as fast as they run: on a busy machine no position and no force is late."""
    line = VirtualLine(options)
    line.late = (0.0, 0.0)

    @contextlib.contextmanager
    def opened(*_: object, **_also: object) -> Iterator[Connection]:
        yield Connection(line, PORT, lambda: None, behind_port=True)

    for module in ("running.session", "running.motors"):
        patch.setattr(f"hapsim.{module}.open_connection", opened)
    clock = SimpleNamespace(sleep=time.sleep, monotonic_ns=lambda: round(line.monotonic() * 1e9))
    patch.setattr("hapsim.loop.portable.time", clock)
    return line.device
