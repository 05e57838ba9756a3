"""The mock's end of its terminal: it never waits for room, as no device's tick may.

A frame that was begun is ended, before anything else, as soon as there is room; what finds none is dropped, frame by
frame and whole (PROTOCOL.md, section 8).
"""

from __future__ import annotations

import numpy as np

from firmware_protocol.compiled import new_record
from firmware_protocol.frames import ROOM
from hapsim.compiling.native import array_at, record_at
from hapsim.loop.endings import FAILED
from hapsim.loop.system import SCRATCH, read_some, write_some
from hapsim.loop.transport import Transport, receiver, sender

_TRANSMITTER = np.dtype(
    [
        ("number", np.int64),  # of the descriptor
        ("first", np.int64),  # of what was begun and is to be ended: unsent[first:stop]
        ("stop", np.int64),
        ("unsent", np.uint8, ROOM),
        SCRATCH,
    ],
    align=True,
)

_transmitter_at, _bytes_at = record_at(_TRANSMITTER), array_at(np.uint8)


@receiver
def receive(context, buffer, room, timeout_ns):
    port = _transmitter_at(context)
    return read_some(port.number, _bytes_at(buffer, room), timeout_ns, port.scratch)


@sender
def send(context, buffer, stop):
    """FAILED where something was dropped. Of no bytes at all: what was begun is ended, if it can be."""
    port = _transmitter_at(context)
    if port.first < port.stop:
        sent = write_some(port.number, port.unsent, port.first, port.stop)
        port.first += sent if sent > 0 else 0
        if port.first < port.stop:
            return FAILED
    data = _bytes_at(buffer, stop)
    at = write_some(port.number, data, 0, stop)
    if at < 0:
        return at
    if at == stop:
        return 0
    port.first = port.stop = 0
    while at > 0 and data[at - 1] != 0:
        port.unsent[port.stop] = data[at]
        port.stop += 1
        at += 1
    return FAILED


def transmitter_transport(number: int) -> Transport:
    """A transport over an open, raw, non-blocking descriptor, which stays the caller's to close."""
    context = new_record(_TRANSMITTER)
    context.number = number
    return Transport(receive, send, context)
