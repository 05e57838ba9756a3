"""The loop in plain Python, for systems without the calls of `system.py` and for transports in Python.

It waits, reads, writes and sleeps in Python, so any delay of Python delays it. The exchange is the same compiled code,
so forces and guards are the same.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import entry
from hapsim.compiling.kept import compile_for
from hapsim.loop.buffers import fetch_in_python, inbox_at, put_bytes
from hapsim.loop.clocks import may_retry, plan_by_device, plan_by_host, plan_in_memory
from hapsim.loop.compiled_loop import SLICE_NS, take_received_frames
from hapsim.loop.endings import FAILED, HUNG_UP, RECEIVED, RING_FULL, RUNNING, TIMED_OUT, ending_of
from hapsim.loop.exchange import HOST_CLOCK, MEMORY_CLOCK, compose_frame, flush_unsent, on_force_sent
from hapsim.loop.transport import PythonTransport

_UNIT_NS = 1_000_000  # of timeouts of Windows' ports


class PortableTransport:
    """A port of pyserial."""

    def __init__(self, serial: Any) -> None:
        from serial import SerialTimeoutException

        self._serial = serial
        self._full: type[OSError] = SerialTimeoutException

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Waits for bytes and receives all. Returns their count, or a code of endings.py."""
        try:
            data = self._first_bytes(max(timeout_ns, 0), buffer.size)
            if data:
                data += self._serial.read(min(self._serial.in_waiting, buffer.size - len(data)))
        except (OSError, TypeError):  # pyserial's own errors are OSErrors; TypeError: the port was closed meanwhile
            return HUNG_UP
        buffer[: len(data)] = np.frombuffer(data, np.uint8)
        return len(data) if data else TIMED_OUT

    def _first_bytes(self, timeout_ns: int, most: int) -> bytes:
        """Waits for a byte; returns it, or what was there already, and b"" after the timeout.

        On Windows a new timeout of pyserial sets up the whole port again, so it stays at its unit, a millisecond. Less
        than that is waited for by looking.
        """
        serial, windows = self._serial, sys.platform == "win32"
        wait_s = _UNIT_NS * 1e-9 if windows else timeout_ns * 1e-9
        if serial.timeout != wait_s:
            serial.timeout = wait_s
        if not windows:
            return bytes(serial.read(1))
        give_up = time.monotonic_ns() + timeout_ns
        while True:
            left_ns = give_up - time.monotonic_ns()
            waiting = min(serial.in_waiting, most)
            if (waiting or left_ns >= _UNIT_NS) and (data := serial.read(waiting or 1)):
                return bytes(data)
            if left_ns <= 0:
                return b""

    def send(self, frame: bytes) -> int:
        """Sends a frame. Returns 0, HUNG_UP, or FAILED if the port takes nothing within its timeout."""
        try:
            self._serial.write(frame)
        except self._full:
            return FAILED
        except OSError:
            return HUNG_UP
        return 0


@entry
def _take_and_compose(loop, now):
    """Returns (the code of the received bytes, the end of the force's frame in the outbox)."""
    code = take_received_frames(loop, inbox_at(loop.inbox), now)
    return code, compose_frame(loop, False) if code == RECEIVED else 0


@entry
def _compose(loop, disarm):
    """Composes the force's frame again, or the frame that disarms and then publishes the last row. Returns its end."""
    stop = compose_frame(loop, disarm)
    if disarm:
        flush_unsent(loop)
    return stop


@entry
def _on_force_sent(loop, now):
    on_force_sent(loop, now)


@entry
def _plan_by_device(loop):
    return plan_by_device(loop)


def entries_for(loop: Any) -> list[tuple[Any, ...]]:
    """Returns the entries that the loop in Python calls, each with arguments of its types."""
    return [(_take_and_compose, loop, 0), (_compose, loop, False), (_on_force_sent, loop, 0), (_plan_by_device, loop)]


class PortableLoop:
    """`run_loop` in Python. `loop`: LOOP; `inbox`: its INBOX; `transport`: fills that inbox."""

    def __init__(self, loop: Any, inbox: Any, transport: PythonTransport) -> None:
        self._loop, self._inbox, self._transport = loop, inbox, transport
        self._control, self._wait = loop.control, loop.wait
        self._frame = b""
        """Frame of the newest force."""
        for function, *arguments in entries_for(loop):
            compile_for(function, *arguments)

    def run(self, _loop: Any = None) -> int:
        """Runs exchanges until the loop ends; returns a code of endings.py. Only RING_FULL leaves the device armed."""
        loop, control, wait = self._loop, self._control, self._wait
        while not control["go"] and not control["stop"]:
            time.sleep(1e-4)
        loop.state.sent_ns = loop.state.tick_ns = time.monotonic_ns()
        by_host, ending = control["clock"] == HOST_CLOCK, RUNNING
        plan = {HOST_CLOCK: plan_by_host, MEMORY_CLOCK: plan_in_memory}.get(int(control["clock"]), _plan_by_device)
        while ending == RUNNING:
            ending = int(plan(loop))
            if ending != RUNNING:
                break
            code = self._take_newest_position(int(wait["begun_ns"]), int(wait["for_ns"]))
            if code != RECEIVED and not (by_host and code == TIMED_OUT and may_retry(loop)):
                ending = int(ending_of(code, control["stop"]))
            elif wait["answers"]:
                if by_host and loop.state.unanswered:
                    loop.state.tick_ns = wait["begun_ns"]
                if by_host:
                    self._frame = self._composed(_compose(loop, False))  # by now the position may be too old
                code = self._send(self._frame)
                ending = RUNNING if code == 0 else int(ending_of(code, 0))
                _on_force_sent(loop, time.monotonic_ns())
        if ending != RING_FULL:
            self._send(self._composed(_compose(loop, True)))
        return ending

    def _take_newest_position(self, begun: int, timeout_ns: int) -> int:
        """Waits for positions and answers the newest, as the function of this name in compiled_loop.py."""
        now, give_up, last_pass = begun, begun + timeout_ns, False
        while True:
            code, stop = _take_and_compose(self._loop, now)
            if code == RECEIVED:
                self._frame = self._composed(stop)
            if code != TIMED_OUT or last_pass:
                return int(code)
            last_pass = now >= give_up or bool(self._control["stop"])
            count = fetch_in_python(self._inbox, self._transport, min(give_up - now, SLICE_NS))
            now = time.monotonic_ns()
            if count < 0:
                return count

    def _composed(self, stop: int) -> bytes:
        io = self._loop.io
        return bytes(io.outbox[int(io.sent.at) : stop])

    def _send(self, frame: bytes) -> int:
        """Sends a frame, perhaps once more. Returns 0, or a code of endings.py."""
        put_bytes(self._loop.io.sent, self._loop.io.outbox, frame)
        return self._transport.send(frame)
