"""Faults between a pseudo-terminal, which a host opens, and the port of a device.

One thread waits for both in the kernel and passes on what comes, in a fraction of a millisecond. When the script
unplugs the device, the pseudo-terminal goes away, so that a host is hung up; when it is plugged in again there is a new
one, under the name that `path` gives it.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from firmware_protocol.compiled import new_record
from hapsim.bringup.faults.injector import Injector, Passed
from hapsim.device.ports import free_name, link_to, open_pseudo_terminal
from hapsim.errors import DeviceError
from hapsim.loop.histogram import HISTOGRAM, Histogram, histogram_of, note

_PIECE = 1 << 16
_LONGEST_WAIT_S = 1.0
_REPORT_S = 0.5
_MOST_WAITING = 1 << 20  # bytes kept for a device that does not take them


class _Host(NamedTuple):
    """The pseudo-terminal that the host opens."""

    near: int
    name: str
    open: contextlib.ExitStack
    """Closes both ends, which hangs up the host, and removes the name."""


class Relay:
    """Passes bytes both ways until `stop` is called, or the device goes away."""

    def __init__(self, device: int, injector: Injector, path: Path | None = None) -> None:
        """`device`: the descriptor of its port, not blocking; `path`: a name for the pseudo-terminal, a link."""
        self._device, self._injector, self._path = device, injector, path
        self._host: _Host | None = None
        self._held_up: dict[bool, deque[Passed]] = {False: deque(), True: deque()}
        self._to_write = b""  # that the device has not taken yet
        self._stopped, self._stop = os.pipe()
        self.unread_bytes = 0
        """Bytes from the device that no host has read."""
        self._delays = new_record(HISTOGRAM)

    def __enter__(self) -> Relay:
        self._plug_in()
        return self

    def __exit__(self, *_: object) -> None:
        self._hang_up()
        for end in (self._stopped, self._stop):
            os.close(end)

    @property
    def name(self) -> str:
        """The port that a host opens. Raises DeviceError while it is unplugged."""
        if self._host is None:
            raise DeviceError("the port is unplugged, by the script")
        return self._host.name

    @property
    def delays(self) -> Histogram:
        """Delays from reading a piece, or from its due time if a fault delayed it, until writing it. Only pieces that
        the receiver took at once count."""
        return histogram_of(self._delays, 1e-6)

    def stop(self) -> None:
        """Ends `run`; may be called from a signal's handler and from any thread."""
        with contextlib.suppress(OSError):
            os.write(self._stop, b".")

    def run(self, duration_s: float | None = None, report: Callable[[], None] = lambda: None) -> bool:
        """Relays for `duration_s`, else until `stop`. Calls `report` twice a second. False if the device went away."""
        ends_s = math.inf if duration_s is None else time.monotonic() + duration_s
        reported_s = -math.inf
        while True:
            now_s = time.monotonic()
            self._keep(self._injector.advance(now_s))
            if not self._injector.plugged:
                self._hang_up()
            elif self._host is None:
                self._plug_in()
            self._send_due(now_s)
            if now_s - reported_s >= _REPORT_S:
                reported_s = now_s
                report()
            if now_s >= ends_s:
                return True
            ready, writable = self._wait(now_s, ends_s)
            if self._stopped in ready:
                return True
            if self._device in ready and not self._read(self._device, False):
                return False
            if writable and not self._write_device():
                return False
            if self._host is not None and self._host.near in ready:
                self._read(self._host.near, True)

    def _wait(self, now_s: float, ends_s: float) -> tuple[list[int], bool]:
        """Returns (the descriptors that can be read, whether the device takes bytes that wait for it)."""
        due = [queue[0].due_s for queue in self._held_up.values() if queue]
        until_s = min([self._injector.next_s(now_s), ends_s, *due])
        ends = [self._stopped, self._device, *([] if self._host is None else [self._host.near])]
        waiting = [self._device] if self._to_write else []
        ready, writable, _ = select.select(ends, waiting, [], min(max(until_s - now_s, 0.0), _LONGEST_WAIT_S))
        return ready, bool(writable)

    def _read(self, descriptor: int, to_device: bool) -> bool:
        """Takes what one side says; returns False if it is gone."""
        try:
            data = os.read(descriptor, _PIECE)
        except BlockingIOError:
            return True
        except OSError:
            return False
        now_s = time.monotonic()
        self._keep(self._injector.take(data, to_device, now_s) if data else [])
        self._send_due(now_s)
        return bool(data)

    def _keep(self, passed: list[Passed]) -> None:
        for one in passed:
            self._held_up[one.to_device].append(one)

    def _send_due(self, now_s: float) -> None:
        for to_device, queue in self._held_up.items():
            due: list[Passed] = []
            while queue and queue[0].due_s <= now_s:
                due.append(queue.popleft())
            data = b"".join(one.data for one in due)
            if due and (self._send_device(data) if to_device else self._send_host(data)):
                written_s = time.monotonic()
                for one in due:
                    note(self._delays, round(1e6 * (written_s - one.due_s)))

    def _send_device(self, data: bytes) -> bool:
        """Returns whether all of it was taken at once."""
        self._to_write = (self._to_write + data)[-_MOST_WAITING:]
        return self._write_device() and not self._to_write

    def _write_device(self) -> bool:
        """Writes what the device takes; returns False if it is gone."""
        try:
            self._to_write = self._to_write[os.write(self._device, self._to_write) :]
        except BlockingIOError:
            return True
        except OSError:
            self._to_write = b""
            return False
        return True

    def _send_host(self, data: bytes) -> bool:
        """Returns whether all of it fits: a host that does not read loses the rest, as behind any driver."""
        written = 0
        if self._host is not None:
            with contextlib.suppress(OSError):
                written = os.write(self._host.near, data)
        self.unread_bytes += len(data) - written
        return written == len(data)

    def _plug_in(self) -> None:
        free_name(self._path)
        near, far = open_pseudo_terminal(
            "", "In memory, with `clock: lockstep`, hapsim.bringup.faults.in_memory injects faults without one"
        )
        with contextlib.ExitStack() as stack:
            for end in (far, near):
                stack.callback(os.close, end)
            name = stack.enter_context(link_to(self._path, os.ttyname(far)))
            self._host = _Host(near, name, stack.pop_all())

    def _hang_up(self) -> None:
        if self._host is not None:
            self._host.open.close()
            self._host = None
