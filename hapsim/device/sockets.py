"""Sockets in place of a serial port: hapsim calls out to a board with Ethernet, or to a mock on another machine.

The frames are those of a serial port. TCP carries them as a stream, without Nagle's delay. A datagram of UDP holds one
frame or several, each whole; a lost one is lost frames.
"""

from __future__ import annotations

import contextlib
import socket
from typing import Any

from hapsim.device.connection import Connection
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.system import require_linux
from hapsim.loop.transport import datagram_transport, descriptor_transport
from hapsim.scene.addresses import EXPECTED, Address, address_of

_CONNECT_S = 5.0
_REFUSAL_S = 0.05  # time in which a machine without a listener refuses a datagram
_ASK = "is the device powered and on this network, and does it list this machine as its peer (`hapsim mock --peer`)?"
_WHY = {
    ConnectionRefusedError: "nothing listens there: is the device powered, or `hapsim mock --listen --peer` running?",
    TimeoutError: f"no answer: {_ASK}",
}


def open_socket(text: str) -> Connection:
    """Opens a connection to the device at an address. Raises UsageError for another text than an address, or off Linux;
    DeviceError, with the remedy, if nothing answers there."""
    caller = connected_socket(text)
    transport = datagram_transport if caller.type == socket.SOCK_DGRAM else descriptor_transport
    return Connection(transport(caller.fileno()), text, caller.close, behind_port=True, advice=_ASK)


def connected_socket(text: str) -> socket.socket:
    """Returns an open, non-blocking socket to an address. Raises as `open_socket`."""
    require_linux("a device behind an address", "use a serial port")
    address = parsed(text)
    caller, place = socket_for(address)
    try:
        caller.settimeout(_CONNECT_S)
        caller.connect(place)
        if address.kind == "udp":
            caller.send(b"")  # a greeting without a frame: it finds out whether anything listens
            caller.settimeout(_REFUSAL_S)
            with contextlib.suppress(TimeoutError):
                caller.recv(1)
    except OSError as error:
        caller.close()
        raise DeviceError(f"{text}: {_WHY.get(type(error), f'cannot be reached: {error.strerror}')}") from error
    send_at_once(caller)
    return caller


def parsed(text: str) -> Address:
    """Returns the address that a text is. Raises UsageError for another text."""
    if (address := address_of(text)) is None:
        raise UsageError(f"{text}: found no address of a device, expected {EXPECTED}")
    return address


def socket_for(address: Address) -> tuple[socket.socket, Any]:
    """Returns a new socket of an address's kind, and the place for the socket's calls. Raises DeviceError for an
    unknown host."""
    of_kind = socket.SOCK_STREAM if address.kind == "tcp" else socket.SOCK_DGRAM
    try:
        family, kind, number, _, place = socket.getaddrinfo(address.host, address.port, type=of_kind)[0]
    except (OSError, UnicodeError) as error:
        raise DeviceError(f"{address}: the host {address.host} is not known: write its number, or its name") from error
    return socket.socket(family, kind, number), place


def send_at_once(stream: socket.socket) -> None:
    """Makes a socket non-blocking, and send each frame at once."""
    if stream.type == socket.SOCK_STREAM:
        stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    stream.setblocking(False)
