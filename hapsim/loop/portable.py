"""The loop in plain Python over pyserial: for systems without the system calls of `system.py`, and what the compiled
loop is measured against.

It waits, reads, writes and sleeps in Python; an exchange itself is the same compiled code. So its forces are the same,
and its guards; but whatever holds Python up holds it up.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from hapsim.compiled import compile_for, jit
from hapsim.loop.codes import FAILED, HEARD, HUNG_UP, TIMED_OUT
from hapsim.loop.endings import GOES_ON, GONE, RING_FULL, ending_of, told_to_end
from hapsim.loop.exchange import HOST_CLOCK, Loop, compose_disarm, compose_force, digest, never_sent, sent
from hapsim.loop.histogram import note
from hapsim.loop.paced_by_host import next_due
from hapsim.loop.waiting import SLICE_NS


class PortablePort:
    """A port as pyserial has it, read and written from Python."""

    def __init__(self, serial: Any) -> None:
        self._serial = serial

    def receive(self, inbox: np.void, timeout_ns: int) -> int:
        """Waits for bytes, and takes all that are there into an inbox that is used up: their count, or a code."""
        inbox["start"] = inbox["stop"] = 0
        try:
            self._serial.timeout = max(timeout_ns, 0) * 1e-9
            data = self._serial.read(1)
            if data:
                data += self._serial.read(min(self._serial.in_waiting, inbox["bytes"].size - 1))
        except (OSError, TypeError):  # pyserial's own errors are OSErrors; TypeError where it was closed meanwhile
            return HUNG_UP
        if not data:
            return TIMED_OUT
        inbox["bytes"][: len(data)] = np.frombuffer(data, np.uint8)
        inbox["stop"] = len(data)
        return len(data)

    def send(self, frame: bytes) -> int:
        """0, or FAILED."""
        try:
            self._serial.write(frame)
        except OSError:
            return FAILED
        return 0


@jit
def digest_and_compose(loop, now):
    """(what `digest` says, where the force's frame in the outbox ends), in one call from Python."""
    code = digest(loop, now)
    return code, compose_force(loop) if code == HEARD else 0


class PortableLoop:
    """`run_paced_by_device` and `run_paced_by_host` in Python."""

    def __init__(self, loop: Loop, port: PortablePort) -> None:
        self._port = port
        # The compiled code never touches this loop's port, which is no transport of compiled code.
        self._loop = loop._replace(port=0)
        compile_for(digest_and_compose, self._loop, 0)
        compile_for(sent, self._loop, 0)
        compile_for(compose_disarm, self._loop)
        compile_for(show_last_rows, self._loop)
        compile_for(next_due, self._loop, 0, 0)
        compile_for(note, loop.statistics.lateness, 0)

    def run(self, _loop: Loop) -> int:
        """Exchanges until something ends it; returns what did. RING_FULL alone leaves the device armed."""
        while not self._loop.control["go"] and not self._loop.control["stop"]:
            time.sleep(1e-4)
        host = self._loop.control["clock"] == HOST_CLOCK
        ending = self._paced_by_host() if host else self._paced_by_device()
        if ending != RING_FULL:
            self._let_go()
        return ending

    def _paced_by_device(self) -> int:
        while (ending := self._told_to_end()) == GOES_ON:
            code, stop = self._take(time.monotonic_ns() + int(self._loop.control["silence_ns"]))
            if code != HEARD:
                return int(ending_of(code, self._loop.control["stop"]))
            if self._answer(stop) != 0:
                return GONE
        return ending

    def _paced_by_host(self) -> int:
        loop, period = self._loop, int(self._loop.control["period_ns"])
        loop.state["tick_ns"] = time.monotonic_ns()
        code, stop = self._take(time.monotonic_ns() + int(loop.control["silence_ns"]))
        due = time.monotonic_ns() + period
        while code in (HEARD, TIMED_OUT):
            if (ending := self._told_to_end()) != GOES_ON:
                return ending
            now = self._sleep_until(due)
            if loop.control["stop"]:
                continue  # woken up for that, not for an exchange
            note(loop.statistics.lateness, now - due)
            due = int(next_due(loop, due, now))
            # One that came after its tick was over is taken first, as in the compiled loop.
            code, newer = self._take(now)
            if code not in (HEARD, TIMED_OUT):
                break
            if loop.state["unanswered"]:
                loop.state["tick_ns"] = now
            stop = newer or stop
            if self._answer(stop) != 0:
                return GONE
            code, newer = self._take(due)
            stop = newer or stop
            if code == TIMED_OUT and time.monotonic_ns() - int(loop.state["newest_ns"]) > loop.control["silence_ns"]:
                break
        return int(ending_of(code, loop.control["stop"]))

    def _sleep_until(self, due: int) -> int:
        """Sleeps until `due`, or until told to stop; the time of waking up."""
        while (left := due - time.monotonic_ns()) > 0 and not self._loop.control["stop"]:
            time.sleep(min(left, SLICE_NS) * 1e-9)
        return time.monotonic_ns()

    def _told_to_end(self) -> int:
        return int(told_to_end(self._loop.control, self._loop.state, self._loop.ring))

    def _take(self, give_up: int) -> tuple[int, int]:
        """Waits for a position until `give_up`: (HEARD, where the force's frame ends), or (a code, 0)."""
        now = time.monotonic_ns()
        last_look = False
        while True:
            code, stop = digest_and_compose(self._loop, now)
            if code != TIMED_OUT or last_look:
                return int(code), int(stop)
            last_look = now >= give_up or bool(self._loop.control["stop"])
            count = self._port.receive(self._loop.inbox, min(give_up - now, SLICE_NS))
            now = time.monotonic_ns()
            if count < 0:
                return count, 0

    def _answer(self, stop: int) -> int:
        code = self._port.send(self._loop.desk["outbox"][:stop].tobytes())
        sent(self._loop, time.monotonic_ns())
        return code

    def _let_go(self) -> None:
        stop = compose_disarm(self._loop)
        self._port.send(self._loop.desk["outbox"][:stop].tobytes())
        show_last_rows(self._loop)


@jit
def show_last_rows(loop):
    """`never_sent`, callable from Python."""
    never_sent(loop)
