"""The mock behind an address, served in real time: it answers one peer alone, over TCP or UDP.

The compiled mock has one descriptor from beginning to end. Each host that calls gets a socket of its own, which takes
the descriptor's place, except while the mock is armed: a host that died keeps it until the watchdog expires.
"""

from __future__ import annotations

import contextlib
import os
import socket
import threading
from collections.abc import Callable, Iterator
from ipaddress import ip_address
from typing import Any

from firmware_protocol import schema
from hapsim.device.mock.terminal import served
from hapsim.device.mock.wire import transmitter_transport, uart_transport
from hapsim.device.sockets import parsed, send_at_once, socket_for
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.system import LARGEST_DATAGRAM, require_linux
from hapsim.loop.transport import datagram_transport

_LOOK_S = 0.1  # how often a listener that nobody calls looks whether it is to end


@contextlib.contextmanager
def listening(
    mock: Any, as_hardware: bool = False, *, address: str, peer: str, refused: Callable[[str], None] = lambda _: None
) -> Iterator[str]:
    """Serves `mock`, a MOCK, at an address while open; yields the address, with the port that the system chose for 0.

    Args:
        as_hardware: as of `served`.
        peer: name or number of the only machine that is answered.
        refused: called with a sentence on a call that is not answered.

    Raises UsageError for a wrong address or peer, DeviceError if the address cannot be had.
    """
    require_linux("a mock that listens", "`hapsim run` has the mock in memory")
    at, peers = parsed(address), _numbers(peer)
    listener, place = socket_for(at)
    with contextlib.ExitStack() as stack:
        stack.enter_context(listener)
        listener.settimeout(_LOOK_S)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind(place)
            if at.kind == "tcp":
                listener.listen(1)
        except OSError as error:
            raise DeviceError(f"{at}: the mock cannot listen there: {error.strerror}") from error
        nobody, other_end = os.pipe()  # reads as hung up until a host has called
        os.close(other_end)
        stack.callback(os.close, nobody)
        if at.kind == "udp":
            transport = datagram_transport(nobody)
        else:
            timed = mock.byte_ns or mock.turnaround_ns
            transport = uart_transport(nobody, mock) if timed else transmitter_transport(nobody)
        service = stack.enter_context(served(mock, transport, as_hardware))

        def answer() -> None:
            """Takes hosts one after the other, in place of nobody."""
            while not service.stop:
                with contextlib.suppress(OSError):  # nobody called, or has gone again
                    caller, sender = _call(listener)
                    with caller or contextlib.nullcontext():
                        if _plain(sender[0]) not in peers:
                            refused(f"refused {sender[0]}, which is not the peer {peer}")
                        elif mock.board.state == schema.ARMED:
                            refused(f"refused {sender[0]}: another program has armed the device")
                        else:
                            with caller or _socket_to(listener, sender) as own:
                                send_at_once(own)
                                os.dup2(own.fileno(), nobody, inheritable=False)

        thread = threading.Thread(target=answer, name="listener", daemon=True)
        thread.start()
        stack.callback(thread.join)
        stack.callback(setattr, service, "stop", 1)
        yield str(at._replace(port=listener.getsockname()[1]))


def _numbers(peer: str) -> set[str]:
    """Returns the numbers of a machine. Raises UsageError for an unknown one."""
    try:
        return {_plain(str(place[0])) for *_, place in socket.getaddrinfo(peer, None)}
    except (OSError, UnicodeError) as error:
        raise UsageError(f"--peer: found {peer}, expected the name or the number of a machine: {error}") from error


def _plain(host: str) -> str:
    """Returns a machine's number: without its zone, and that of version 4 if it only looks like version 6."""
    number = ip_address(host.partition("%")[0])
    return str(getattr(number, "ipv4_mapped", None) or number)


def _call(listener: socket.socket) -> tuple[socket.socket | None, Any]:
    """Waits for a call. Returns its socket, if it has one, and where it came from. Raises OSError if nobody calls."""
    if listener.type == socket.SOCK_STREAM:
        return listener.accept()
    return None, listener.recvfrom(LARGEST_DATAGRAM)[1]


def _socket_to(listener: socket.socket, place: Any) -> socket.socket:
    """Returns a socket at the listener's place that takes the datagrams from one place alone."""
    own = socket.socket(listener.family, listener.type, listener.proto)
    own.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    own.bind(listener.getsockname())
    own.connect(place)
    own.setblocking(False)
    with contextlib.suppress(BlockingIOError):
        while True:  # anybody's, before it was connected
            own.recv(LARGEST_DATAGRAM)
    return own
