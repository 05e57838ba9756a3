"""What the loop asks of a port: `receive` and `send`, compiled, chosen by the port's type when the loop is compiled.

A transport is a NamedTuple of what it needs, with an implementation of both registered for it; see descriptor.py
(anything with a file descriptor) and, in the device room, the mock's loopback. The loop itself never knows which.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types

from hapsim.compiled import jit, overload


def receive(port: Any, buffer: Any, start: int, timeout_ns: int) -> Any:
    """Bytes that have arrived, into buffer[start:]: their count, or TIMED_OUT, HUNG_UP, FAILED of codes.py."""
    raise NotImplementedError("only compiled code calls this")


def send(port: Any, buffer: Any, stop: int) -> Any:
    """Sends buffer[:stop]: 0, or HUNG_UP or FAILED."""
    raise NotImplementedError("only compiled code calls this")


def transport(port_type: type, receive_from: Callable[..., Any], send_to: Callable[..., Any]) -> None:
    """Makes `receive` and `send` mean these two functions for ports of `port_type`, a NamedTuple class.

    Their parameters carry the names of `receive`'s and `send`'s.
    """

    def is_ours(port: types.Type) -> bool:
        return isinstance(port, types.BaseNamedTuple) and port.instance_class is port_type

    @overload(receive)
    def choose_receive(port, buffer, start, timeout_ns):  # noqa: ARG001
        if not is_ours(port):
            return None
        return receive_from

    @overload(send)
    def choose_send(port, buffer, stop):  # noqa: ARG001
        if not is_ours(port):
            return None
        return send_to


@jit
def receive_into(port, buffer, start, timeout_ns):
    """`receive`, callable from Python: for the conversation before and after the loop."""
    return receive(port, buffer, start, timeout_ns)


@jit
def send_from(port, buffer, stop):
    """`send`, callable from Python."""
    return send(port, buffer, stop)
