"""The mock's end of the wire: on its pseudo-terminal a transmitter whose bytes take no time, or a UART; or in memory.

The first two never wait for room, as no device's tick may. The transmitter ends a frame that it began as soon as there
is room, before anything else, and drops frames without room completely (PROTOCOL.md, section 8).

On the UART, in real time, a byte arrives with its last bit. The mock's frame is written at the time of its last byte.
The host's bytes count from their own arrival, and `receive_in_time` delivers none that is due after its deadline, the
mock's tick. The system's wake-up latency, some 0.1 ms, comes on top. In virtual time (lockstep) bytes take no time
here: the firmware counts it in samples.

In memory the mock answers within `send`, in virtual time and in the host's thread.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from firmware_protocol.compiled import new_record
from firmware_protocol.frames import ROOM
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_of, array_at, record_at
from hapsim.device.mock.firmware import prepare
from hapsim.device.mock.record import INPUT_BYTES, call_take_bytes, mock_at
from hapsim.loop.endings import FAILED, TIMED_OUT
from hapsim.loop.system import SCRATCH, now_ns, read_some, write_some
from hapsim.loop.transport import Transport, receiver, sender

_TRANSMITTER = np.dtype(
    [
        ("number", np.int64),  # of the descriptor
        ("first", np.int64),  # the end of a frame that was begun: unsent[first:stop]
        ("stop", np.int64),
        ("unsent", np.uint8, ROOM),
        SCRATCH,
    ],
    align=True,
)

_transmitter_at, _bytes_at = record_at(_TRANSMITTER), array_at(np.uint8)


@receiver
def receive_at_once(context, buffer, room, timeout_ns):
    port = _transmitter_at(context)
    return read_some(port.number, _bytes_at(buffer, room), timeout_ns, port.scratch)


@sender
def send_at_once(context, buffer, stop):
    """Sends a frame, and first the end of one that was begun. Returns FAILED if a frame was dropped."""
    port = _transmitter_at(context)
    if port.first < port.stop:
        port.first += max(write_some(port.number, port.unsent, port.first, port.stop), 0)
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
    """Returns a transport over an open, raw, non-blocking descriptor, which the caller closes."""
    context = new_record(_TRANSMITTER)
    context.number = number
    return Transport(receive_at_once, send_at_once, context)


_ROOM = 2 * INPUT_BYTES  # most bytes on the wire in one direction

_WAY = np.dtype(
    [
        ("free_ns", np.float64),  # arrival of the last byte
        ("waiting", np.int64),
        ("due_ns", np.float64, (_ROOM,)),
        ("bytes", np.uint8, (_ROOM,)),
    ],
    align=True,
)

UART = np.dtype(
    [
        ("number", np.int64),  # of the descriptor
        ("mock", np.uint64),  # address of a MOCK
        ("outgoing", _WAY),
        ("incoming", _WAY),
        ("read", np.uint8, (INPUT_BYTES,)),
        SCRATCH,
    ],
    align=True,
)
_uart_at = record_at(UART)


@inlined
def _is_virtual(uart):
    board = mock_at(uart.mock).board
    return board.state == schema.ARMED and board.pacing == schema.LOCKSTEP


@inlined
def _byte_ns(uart):
    return 0.0 if _is_virtual(uart) else mock_at(uart.mock).byte_ns


@helper
def put_on_wire(way, data, count, earliest_ns, byte_ns, whole_frames):
    """Puts data[:count] on the wire from `earliest_ns` on. Returns the number of bytes that fit. `whole_frames`: each
    byte is due with the last one of its frame."""
    fitting = min(count, _ROOM - way.waiting)
    at = way.free_ns if way.free_ns > earliest_ns else earliest_ns
    for i in range(fitting):
        at += byte_ns
        way.bytes[way.waiting + i] = data[i]
        way.due_ns[way.waiting + i] = at
    way.free_ns = at
    way.waiting += fitting
    if whole_frames:
        for i in range(way.waiting - 2, way.waiting - fitting - 1, -1):
            if way.bytes[i] != 0:
                way.due_ns[i] = way.due_ns[i + 1]
    return fitting


@helper
def arrived(way, until_ns):
    """Returns the number of bytes up to the last delimiter that has arrived; of all arrived bytes on a full wire."""
    whole, at = 0, 0
    while at < way.waiting and way.due_ns[at] <= until_ns:
        at += 1
        if way.bytes[at - 1] == 0:
            whole = at
    return at if whole == 0 and way.waiting == _ROOM else whole


@helper
def next_due_ns(way, otherwise_ns):
    """Returns the arrival of the next delimiter in ns, at most `otherwise_ns`."""
    for i in range(way.waiting):
        if way.bytes[i] == 0:
            return min(way.due_ns[i], otherwise_ns)
    return otherwise_ns


@helper
def take_off_wire(way, count):
    """Removes the first `count` bytes."""
    for i in range(count, way.waiting):
        way.bytes[i - count] = way.bytes[i]
        way.due_ns[i - count] = way.due_ns[i]
    way.waiting -= count


@receiver
def receive_in_time(context, buffer, room, timeout_ns):
    uart, buffer = _uart_at(context), _bytes_at(buffer, room)
    now = now_ns(uart.scratch)
    deadline = now + timeout_ns
    while True:
        due = arrived(uart.outgoing, now)
        written = write_some(uart.number, uart.outgoing.bytes, 0, due)
        if written < 0:
            return written
        if written > 0:
            take_off_wire(uart.outgoing, written)
        count = min(arrived(uart.incoming, min(now, deadline)), room)
        if count > 0:
            for i in range(count):
                buffer[i] = uart.incoming.bytes[i]
            take_off_wire(uart.incoming, count)
            return count
        if now >= deadline:
            return TIMED_OUT
        # If the host does not read, the rest waits for the next call: a device's tick never waits.
        wake = np.float64(deadline) if written < due else next_due_ns(uart.outgoing, np.float64(deadline))
        wake = next_due_ns(uart.incoming, wake)
        count = read_some(uart.number, uart.read, np.int64(wake) + 1 - now, uart.scratch)
        now = now_ns(uart.scratch)
        if count < 0:
            return count
        put_on_wire(uart.incoming, uart.read, count, np.float64(now), _byte_ns(uart), False)


@sender
def send_in_time(context, buffer, stop):
    """Sends a frame. Returns FAILED, and drops it, if there is no room."""
    uart = _uart_at(context)
    if stop > _ROOM - uart.outgoing.waiting:
        return FAILED
    earliest, byte_ns = np.float64(now_ns(uart.scratch)), _byte_ns(uart)
    if not _is_virtual(uart):
        earliest += mock_at(uart.mock).turnaround_ns
    put_on_wire(uart.outgoing, _bytes_at(buffer, stop), stop, earliest, byte_ns, True)
    return 0


def uart_transport(number: int, mock: Any) -> Transport:
    """Returns a transport over an open, raw, non-blocking descriptor with the times of `mock`, a MOCK."""
    context = new_record(UART)
    context.number = number
    context.mock = address_of(mock)
    return Transport(receive_in_time, send_in_time, context)


@receiver
def receive_in_memory(context, buffer, room, timeout_ns):  # noqa: ARG001  nothing comes by waiting
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
def send_in_memory(context, buffer, stop):
    if stop > INPUT_BYTES:
        return FAILED
    call_take_bytes(mock_at(context).called.take_bytes, (context, buffer, stop, 0))
    return 0


def loopback_transport(mock: Any) -> Transport:
    """Returns a transport to `mock`, a MOCK."""
    prepare(mock)
    return Transport(receive_in_memory, send_in_memory, mock)
