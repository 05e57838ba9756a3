"""Serving a mock on a descriptor in real time: compiled, without the GIL, until told to stop."""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiled import inlined, jit
from hapsim.device.mock.firmware import INPUT_BYTES, look_at_watchdog, take_bytes, take_sample
from hapsim.loop.port import receive, send
from hapsim.loop.system import now_ns, sleep_until

_IDLE_WAIT_NS = 20_000_000

SERVICE = np.dtype(
    [
        ("stop", np.int64),
        ("late_samples", np.int64),  # samples that this machine took a whole period too late
        ("lost_answers", np.int64),  # bytes that the host did not fetch were thrown away this often
    ]
)


@jit
def serve(port, mock, service, buffer, scratch):
    """Plays the device on `port` until `service.stop`. `buffer`: uint8[INPUT_BYTES], `scratch`: int64[4]."""
    period = np.int64(mock.converters[0].period * 1e9)
    due = np.int64(0)
    ticking = False
    while not service.stop:
        wait = due - now_ns(scratch) if ticking else _IDLE_WAIT_NS
        count = receive(port, buffer, 0, min(wait, _IDLE_WAIT_NS))
        now = now_ns(scratch)
        if count > 0:
            take_bytes(mock, buffer, count, now)
        elif count < 0:
            sleep_until(now + _IDLE_WAIT_NS, scratch)
        before = ticking
        ticking = mock.board.state == schema.ARMED and mock.board.pacing == schema.PACED_BY_DEVICE
        if ticking and not before:
            due = now + period
        if ticking and now >= due:
            take_sample(mock, now)
            due += period
            if now >= due:
                # A device's timer is never late, but this machine was: go on from here instead of catching up.
                service.late_samples += 1
                due = now + period
        look_at_watchdog(mock, now)
        _send_outbox(port, mock, service)


@inlined
def _send_outbox(port, mock, service):
    if mock.board.out > 0:
        if send(port, mock.outbox, mock.board.out) != 0:
            service.lost_answers += 1
        mock.board.out = 0


def input_buffer() -> np.ndarray:
    """A buffer of the size that `serve` wants."""
    return np.zeros(INPUT_BYTES, np.uint8)
