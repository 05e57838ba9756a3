"""The transport over a file descriptor: a serial port or a pseudo-terminal, opened and configured by somebody else."""

from __future__ import annotations

import numpy as np

from firmware_protocol.records import new_record
from hapsim.compiling.native import array_at, record_at
from hapsim.loop.system import SCRATCH, read_some, write_all
from hapsim.loop.transport import Transport, receiver, sender

_SEND_TIMEOUT_NS = 100_000_000  # a port that takes nothing for this long is no port

_DESCRIPTOR = np.dtype([("number", np.int64), SCRATCH], align=True)

_descriptor_at, _bytes_at = record_at(_DESCRIPTOR), array_at(np.uint8)


@receiver
def receive(context, buffer, room, timeout_ns):
    port = _descriptor_at(context)
    return read_some(port.number, _bytes_at(buffer, room), timeout_ns, port.scratch)


@sender
def send(context, buffer, stop):
    port = _descriptor_at(context)
    return write_all(port.number, _bytes_at(buffer, stop), stop, _SEND_TIMEOUT_NS, port.scratch)


def descriptor_transport(number: int) -> Transport:
    """A transport over an open, raw, non-blocking descriptor, which stays the caller's to close."""
    context = new_record(_DESCRIPTOR)
    context.number = number
    return Transport(receive, send, context)
