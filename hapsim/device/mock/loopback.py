"""The transport that needs no operating system: the mock in the same process, bytes handed over in memory.

The mock answers within `send`, so this is for lockstep: virtual time, one thread, as fast as it goes.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling.native import array_at
from hapsim.device.mock.firmware import INPUT_BYTES, call_take_bytes, mock_at, prepare
from hapsim.loop.endings import FAILED, TIMED_OUT
from hapsim.loop.transport import Transport, receiver, sender

_bytes_at = array_at(np.uint8)


@receiver
def receive(context, buffer, room, timeout_ns):  # noqa: ARG001  nothing comes by waiting
    """What the mock said, up to `room` bytes: their number, or TIMED_OUT."""
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
    """A transport to `mock`, a MOCK."""
    prepare(mock)
    return Transport(receive, send, mock)


def outbox_of(mock: Any) -> NDArray[np.uint8]:
    """What the mock has sent and nobody read yet."""
    return mock.outbox[: int(mock.board.out)].copy()
