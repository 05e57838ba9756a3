"""Serving a mock over a transport in real time: compiled, without the GIL, until told to stop."""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from hapsim.compiling import entry, inlined
from hapsim.device.mock.firmware import INPUT_BYTES, call_event, call_take_bytes
from hapsim.loop.clocks import next_point
from hapsim.loop.system import SCRATCH, now_ns, sleep_until
from hapsim.loop.transport import TRANSPORT, receive, send

_IDLE_WAIT_NS = 20_000_000

SERVICE = np.dtype(
    [
        ("transport", TRANSPORT),
        ("stop", np.int64),
        ("late_samples", np.int64),  # samples that this machine took a whole period too late
        ("lost_answers", np.int64),  # bytes that the host did not fetch were thrown away this often
        ("input", np.uint8, (INPUT_BYTES,)),
        SCRATCH,
    ],
    align=True,
)


def new_service(transport: Any) -> Any:
    """SERVICE, a record, over a transport."""
    service = new_record(SERVICE)
    service.transport = transport.record
    return service


@entry
def serve(mock, service):
    """Plays the device until `service.stop`. `mock`: MOCK, prepared; `service`: SERVICE."""
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
        call_event(mock.called.look_at_watchdog, (mock.address, now))
        _send_outbox(mock, service)


@inlined
def _send_outbox(mock, service):
    """Whatever happens it is empty then. With nothing in it, what the transport had begun is ended."""
    if send(service.transport, mock.outbox, 0, mock.board.out) != 0 and mock.board.out > 0:
        service.lost_answers += 1
    mock.board.out = 0
