"""The mock on a pseudo-terminal, served in real time: a port that any program opens like a serial device's.

The serving function is compiled and holds no GIL. `listening.py` serves the mock behind an address in the same way.
"""

from __future__ import annotations

import contextlib
import os
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling import entry, inlined
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import Counted, on_compilation
from hapsim.device.mock.firmware import prepare
from hapsim.device.mock.record import INPUT_BYTES, call_event, call_take_bytes
from hapsim.device.mock.wire import transmitter_transport, uart_transport
from hapsim.device.ports import free_name, link_to, open_pseudo_terminal
from hapsim.loop.clocks import next_point
from hapsim.loop.counts import Progress
from hapsim.loop.realtime import remove_timer_slack, use_fifo
from hapsim.loop.system import SCRATCH, now_ns, require_linux, sleep_until
from hapsim.loop.transport import TRANSPORT, receive, send
from hapsim.stopping import STOPS

Serving = Callable[[Any, bool], contextlib.AbstractContextManager[str]]
"""Function that serves a MOCK, as hardware or not, while open, and yields where."""

_IDLE_WAIT_NS = 20_000_000

SERVICE = np.dtype(
    [
        ("transport", TRANSPORT),
        ("stop", np.int64),
        ("late_samples", np.int64),  # samples that this machine took a whole period too late
        ("lost_answers", np.int64),  # times that bytes which the host did not read were dropped
        ("input", np.uint8, (INPUT_BYTES,)),
        SCRATCH,
    ],
    align=True,
)


def new_service(transport: Any) -> Any:
    """Returns a SERVICE over a transport."""
    service = new_record(SERVICE)
    service.transport = transport.record
    return service


@entry
def serve(mock, service):
    """Runs the device until `service.stop`. `mock`: MOCK, prepared; `service`: SERVICE."""
    period = np.int64(mock.converters[0].period * 1e9)
    due = np.int64(0)
    ticking = False
    while not service.stop:
        wait = due - now_ns(service.scratch) if ticking else _IDLE_WAIT_NS
        count = receive(
            service.transport, service.input, 0, service.input.size, wait if wait < _IDLE_WAIT_NS else _IDLE_WAIT_NS
        )
        now = now_ns(service.scratch)
        if count > 0:
            call_take_bytes(mock.called.take_bytes, (mock.address, np.uint64(service.input.ctypes.data), count, now))
        elif count < 0:
            sleep_until(now + _IDLE_WAIT_NS, service.scratch)
        before = ticking
        ticking = mock.board.state == schema.ARMED and mock.board.pacing == schema.PACED_BY_DEVICE
        if ticking and not before:
            due = now + period
        if ticking and now >= due:
            call_event(mock.called.take_sample, (mock.address, now))
            # A device's timer is never late, but this machine may be.
            due, late = next_point(due, now, period)
            service.late_samples += late
        call_event(mock.called.check_watchdog, (mock.address, now))
        _send_outbox(mock, service)


@inlined
def _send_outbox(mock, service):
    """Sends and empties the outbox, even on failure. An empty outbox lets the transport end a frame that it began."""
    if send(service.transport, mock.outbox, 0, mock.board.out) != 0 and mock.board.out > 0:
        service.lost_answers += 1
    mock.board.out = 0


def require_pseudo_terminal() -> None:
    """Raises UsageError if the system is not Linux."""
    require_linux("the mock on a pseudo-terminal", "`hapsim run` has the mock in memory; a device is run on its port")


@contextlib.contextmanager
def serving(mock: Any, as_hardware: bool = False) -> Iterator[str]:
    """Serves `mock`, a MOCK, from a thread of its own while open; yields the port's path. Raises DeviceError if the
    system has no pseudo-terminal left, UsageError if it is not Linux.

    `as_hardware`: the thread runs before all other programs, as a device's timer does, if the system grants that.
    """
    require_pseudo_terminal()
    near, far = open_pseudo_terminal(
        " for the mock",
        "With `clock: lockstep` in the scene's `device`, the mock of `run` and `measure` runs in memory and needs none",
    )
    try:
        transport = uart_transport(near, mock) if mock.byte_ns or mock.turnaround_ns else transmitter_transport(near)
        with served(mock, transport, as_hardware):
            yield os.ttyname(far)
    finally:
        os.close(near)
        os.close(far)


@contextlib.contextmanager
def served(mock: Any, transport: Any, as_hardware: bool) -> Iterator[Any]:
    """Serves `mock`, a MOCK, over a transport from a thread of its own while open; yields the SERVICE. `as_hardware`:
    as of `serving`."""
    # Compiled before a host can connect: no host waits for as long as a first compilation takes.
    prepare(mock)
    service = new_service(transport)
    compile_for(serve, mock, service)

    def serve_without_slack() -> None:
        remove_timer_slack()
        serve(mock, service)

    # A daemon: otherwise the program's end would wait for this thread before it ends the session.
    thread = threading.Thread(target=serve_without_slack, name="mock device", daemon=True)
    thread.start()
    try:
        with use_fifo(thread.native_id or 0) if as_hardware else contextlib.nullcontext():
            yield service
    finally:
        service.stop = 1
        thread.join()


def serve_until_stopped(
    assemble: Callable[[], Any],
    link: Path | None,
    announce: Callable[[str], None],
    report: Callable[[Progress], None],
    as_hardware: bool = False,
    serve_at: Serving | None = None,
) -> None:
    """Serves the MOCK that `assemble` returns until SIGINT, SIGTERM or SIGHUP; calls `announce(path)` once it answers.

    `link`: another name for the port, a symbolic link removed at the end. `as_hardware`: of `serving`. `serve_at`: in
    place of `serving`. Raises UsageError if the link's name is taken."""
    require_pseudo_terminal()  # before anything is changed
    free_name(link)
    # A queue, and not an event: a handler that sets an event may wait for the event's own lock.
    stops: SimpleQueue[None] = SimpleQueue()
    for number in STOPS:
        signal.signal(number, lambda _number, _frame: stops.put(None))
    counted = Counted(lambda name, share: report(Progress("compiling", name, share=share)))
    with (
        on_compilation(counted.add),
        (serve_at or serving)(assemble(), as_hardware) as path,
        link_to(link, path) as name,
    ):
        if not stops.empty():
            raise KeyboardInterrupt  # before the port is announced
        announce(name)
        report(Progress("serving", name))
        stops.get()
