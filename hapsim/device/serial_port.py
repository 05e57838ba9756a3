"""Opening a device's serial port: found, configured and locked by pyserial, then raw for the loop.

Two locks, because each alone lets somebody in: pyserial's is advisory, and the terminal's own does not stop root. Both
are the kernel's and end with the process, however it ends.
"""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hapsim.device.connection import Connection
from hapsim.device.port_holder import who_holds
from hapsim.device.port_name import leads_to
from hapsim.errors import DeviceError
from hapsim.loop.transport import descriptor_transport

_PSEUDO_TERMINALS = range(136, 144)  # major numbers, Linux's Documentation/admin-guide/devices.txt
_WRITE_TIMEOUT_S = 1.0  # of the portable loop, whose own interpreter may be held up for a tenth of a second


def open_serial_port(path: str, baud: int) -> Connection:
    """Opens a port at `baud` bit/s for the compiled loop. DeviceError, with what to do, where that fails."""
    port = _open(path, baud)
    descriptor = port.fileno()
    _make_raw(descriptor)
    return Connection(
        transport=descriptor_transport(descriptor),
        name=path,
        close=port.close,
        baud=baud,
        note=_low_latency(port),
        has_timer=True,
        in_hand=True,
    )


def open_portable_port(path: str, baud: int) -> Connection:
    """Opens a port at `baud` bit/s for the portable loop. DeviceError, with what to do, where that fails."""
    from hapsim.loop.portable import PortableTransport

    port = _open(path, baud)
    return Connection(
        transport=PortableTransport(port),
        name=path,
        close=port.close,
        baud=baud,
        note=_low_latency(port),
        has_timer=True,
        in_hand=True,
    )


@contextlib.contextmanager
def raw_port(path: str, baud: int) -> Iterator[int]:
    """The descriptor of an open port, raw, locked and not blocking, for who reads and writes it himself. DeviceError,
    with what to do, where it cannot be opened."""
    with contextlib.closing(_open(path, baud)) as port:
        _make_raw(port.fileno())
        _low_latency(port)
        yield port.fileno()


def _open(path: str, baud: int) -> Any:
    import serial

    try:
        return serial.Serial(path, baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise DeviceError(_why_not(path, baud, error)) from error


def serial_ports() -> list[dict[str, str]]:
    """The serial ports that the system knows: path, description and hardware of each."""
    from serial.tools import list_ports

    return [
        {"port": port.device, "description": port.description or "", "hardware": port.hwid or ""}
        for port in sorted(list_ports.comports())
    ]


def _make_raw(descriptor: int) -> None:
    """VMIN = 1: then "nothing there" is EAGAIN and only a hang-up reads as empty."""
    import fcntl
    import termios

    attributes = termios.tcgetattr(descriptor)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    if _is_pseudo_terminal(descriptor):
        return  # its other side keeps it open, and with it what the next line sets: nobody but root could open it again
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def _is_pseudo_terminal(descriptor: int) -> bool:
    return os.major(os.fstat(descriptor).st_rdev) in _PSEUDO_TERMINALS


def _low_latency(port: object) -> str:
    """Asks the driver not to gather bytes (FTDI: 16 ms by default). A note where it cannot be asked."""
    try:
        port.set_low_latency_mode(True)  # type: ignore[attr-defined]
    except (ValueError, OSError, AttributeError):
        return "the port's driver offers no low-latency mode"
    return ""


_BUSY = ("exclusively lock", "busy", "PermissionError(13, 'Access is denied.'")  # the last is how Windows says it


def _why_not(path: str, baud: int, error: Exception) -> str:
    code = getattr(error, "errno", None)
    text = str(error)
    if code == errno.ENOENT or "No such file" in text or "FileNotFoundError" in text:
        ports = ", ".join(port["port"] for port in serial_ports())
        found = f"Ports found: {ports or 'none'} (`hapsim ports` tells more)"
        link = leads_to(path)
        if link is not None:
            return f"{path}: a link to {link}, which is gone: was the program that made it stopped? {found}"
        return f"{path}: no such port. {found}"
    if code in (errno.EACCES, errno.EPERM) or "Permission denied" in text:
        return f"{path}: not permitted. On most systems: add yourself to the group dialout and log in again"
    if code in (errno.EAGAIN, errno.EBUSY) or any(word in text for word in _BUSY):
        holders = who_holds(path)
        which = f": {holders}. Close it" if holders else ". Close it (ModemManager is a frequent one)"
        return f"{path}: another program is using the port{which} and try again"
    if code in (errno.ENOTTY, errno.EISDIR) or "not configure port" in text or "Inappropriate ioctl" in text:
        if Path(path).is_file() or Path(path).is_dir():
            return f"{path}: not a serial port, but a {'file' if Path(path).is_file() else 'directory'}"
        return f"{path}: not a serial port, or one that cannot be set to {baud} baud"
    return f"{path}: cannot be opened: {text}"
