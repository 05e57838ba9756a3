"""A transport: the code that moves bytes between the loop and a device, behind addresses.

The loop calls two functions by their addresses, with the address of the transport's context. This file has the
transport over a file descriptor (a serial port, a pseudo-terminal or a socket); those of the mock are in `device/mock`.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol.compiled import new_record
from hapsim.compiling import inlined
from hapsim.compiling.native import PlainNative, address_of, array_at, function_at, native, record_at
from hapsim.loop.system import SCRATCH, read_datagrams, read_some, write_all

TRANSPORT = np.dtype(
    [("receive", np.uint64), ("send", np.uint64), ("context", np.uint64), ("descriptor", np.int64)], align=True
)

_RECEIVE = types.int64(types.uint64, types.uint64, types.int64, types.int64)
_SEND = types.int64(types.uint64, types.uint64, types.int64)

_call_receive, _call_send = function_at(_RECEIVE), function_at(_SEND)

receiver = native(_RECEIVE.return_type, *_RECEIVE.args)
"""Decorates a receiving function (context, buffer, room, timeout_ns). It puts at most `room` received bytes into
`buffer`, and returns their count, or TIMED_OUT, HUNG_UP, FAILED. Context and buffer are addresses."""

sender = native(_SEND.return_type, *_SEND.args)
"""Decorates a sending function (context, buffer, stop). It sends `stop` bytes, and returns 0, HUNG_UP or FAILED."""


@inlined
def receive(transport, buffer, at, room, timeout_ns):
    """Receives at most `room` bytes into buffer[at:]. Returns their count, or TIMED_OUT, HUNG_UP, FAILED."""
    address = np.uint64(buffer.ctypes.data) + np.uint64(at)
    return _call_receive(transport.receive, (transport.context, address, np.int64(room), np.int64(timeout_ns)))


@inlined
def send(transport, buffer, start, stop):
    """Sends buffer[start:stop]. Returns 0, HUNG_UP or FAILED."""
    address = np.uint64(buffer.ctypes.data) + np.uint64(start)
    return _call_send(transport.send, (transport.context, address, np.int64(stop - start)))


class PythonTransport(Protocol):
    """A transport for Python."""

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Receives bytes into a buffer. Returns their count, or a code of endings.py."""

    def send(self, frame: bytes) -> int:
        """Sends a frame. Returns 0, or a code of endings.py."""


class Transport:
    """An open transport for the loop, and for Python before and after it."""

    def __init__(self, receive_from: PlainNative, send_to: PlainNative, context: Any, descriptor: int = -1) -> None:
        """`context`: a record. `descriptor`: the one to wait for; -1: nothing comes by waiting."""
        self._receive, self._send, self._context = receive_from, send_to, context
        self.record = new_record(TRANSPORT)
        self.record.receive = receive_from.address()
        self.record.send = send_to.address()
        self.record.context, self.record.descriptor = address_of(context), descriptor

    def receive(self, buffer: NDArray[np.uint8], timeout_ns: int) -> int:
        """Receives bytes into a buffer. Returns their count, or a code of endings.py."""
        return int(self._receive(int(self.record.context), buffer.ctypes.data, buffer.size, timeout_ns))

    def send(self, frame: bytes) -> int:
        """Sends a frame. Returns 0, HUNG_UP or FAILED."""
        data = np.frombuffer(frame, np.uint8)
        return int(self._send(int(self.record.context), data.ctypes.data, data.size))


_SEND_TIMEOUT_NS = 100_000_000  # a port that takes nothing for this long has failed

_DESCRIPTOR = np.dtype([("number", np.int64), SCRATCH], align=True)

_descriptor_at, _bytes_at = record_at(_DESCRIPTOR), array_at(np.uint8)


@receiver
def receive_from_descriptor(context, buffer, room, timeout_ns):
    port = _descriptor_at(context)
    return read_some(port.number, _bytes_at(buffer, room), timeout_ns, port.scratch)


@receiver
def receive_datagrams(context, buffer, room, timeout_ns):
    port = _descriptor_at(context)
    return read_datagrams(port.number, _bytes_at(buffer, room), timeout_ns, port.scratch)


@sender
def send_to_descriptor(context, buffer, stop):
    port = _descriptor_at(context)
    return write_all(port.number, _bytes_at(buffer, stop), stop, _SEND_TIMEOUT_NS, port.scratch)


def descriptor_transport(number: int, receive_from: PlainNative = receive_from_descriptor) -> Transport:
    """Returns a transport over an open, raw, non-blocking descriptor, which the caller closes."""
    context = new_record(_DESCRIPTOR)
    context.number = number
    return Transport(receive_from, send_to_descriptor, context, number)


def datagram_transport(number: int) -> Transport:
    """Returns the same over the descriptor of a socket of datagrams, each of whole frames."""
    return descriptor_transport(number, receive_datagrams)
