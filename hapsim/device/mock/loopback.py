"""The transport that needs no operating system: the mock in the same process, bytes handed over in memory.

The mock answers within `send`, so this is for lockstep: virtual time, one thread, as fast as it goes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined, part
from hapsim.device.mock.firmware import INPUT_BYTES, Mock, take_bytes
from hapsim.loop.codes import FAILED, TIMED_OUT
from hapsim.loop.port import transport


class LoopbackPort(NamedTuple):
    """The host's end of a line to a mock in memory."""

    mock: Mock


@inlined
def _receive(port, buffer, start, timeout_ns):  # noqa: ARG001  nothing comes by waiting
    waiting = port.mock.board.out
    count = min(waiting, buffer.size - start)
    if count == 0:
        return TIMED_OUT
    outbox = port.mock.outbox
    for i in range(count):
        buffer[start + i] = outbox[i]
    for i in range(count, waiting):
        outbox[i - count] = outbox[i]
    port.mock.board.out = waiting - count
    return count


@part
def _send(port, buffer, stop):
    if stop > INPUT_BYTES:
        return FAILED
    take_bytes(port.mock, buffer, stop, 0)
    return 0


transport(LoopbackPort, _receive, _send)


def loopback_port(mock: Mock) -> LoopbackPort:
    """A line to `mock`."""
    return LoopbackPort(mock)


def outbox_of(mock: Mock) -> NDArray[np.uint8]:
    """What the mock has sent and nobody read yet."""
    return mock.outbox[: int(mock.board["out"])].copy()
