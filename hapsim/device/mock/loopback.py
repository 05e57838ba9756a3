"""The transport in memory: the mock answers within `send`, in virtual time and in the host's thread."""

from __future__ import annotations

from typing import Any

import numpy as np

from hapsim.compiling.native import array_at
from hapsim.device.mock.firmware import INPUT_BYTES, call_take_bytes, mock_at, prepare
from hapsim.loop.endings import FAILED, TIMED_OUT
from hapsim.loop.transport import Transport, receiver, sender

_bytes_at = array_at(np.uint8)


@receiver
def receive(context, buffer, room, timeout_ns):  # noqa: ARG001  nothing comes by waiting
    mock, buffer = mock_at(context), _bytes_at(buffer, room)
    waiting = mock.board.out
    count = waiting if waiting < room else room
    if count == 0:
        return TIMED_OUT
    for i in range(np.uint64(count)):
        buffer[i] = mock.outbox[i]
    for i in range(count, waiting):
        mock.outbox[i - count] = mock.outbox[i]
    mock.board.out = waiting - count
    return count


@sender
def send(context, buffer, stop):
    if stop > INPUT_BYTES:
        return FAILED
    call_take_bytes(mock_at(context).called.take_bytes, (context, buffer, stop, 0))
    return 0


def loopback_transport(mock: Any) -> Transport:
    """Returns a transport to `mock`, a MOCK."""
    prepare(mock)
    return Transport(receive, send, mock)
