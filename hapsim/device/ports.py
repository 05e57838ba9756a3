"""Ports: opening a device's serial port, or the socket in its place, and links to pseudo-terminals under a user's name.

pyserial finds, configures and locks a port, which is then raw for the loop. There are two locks, because pyserial's is
advisory and the terminal's own does not stop root. The kernel releases both when the process ends.

A killed program leaves its link behind. Call `free_name` before opening a pseudo-terminal: the system reuses the number
of a closed one, and an old link would then seem to lead to a port in use.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hapsim.device.connection import Connection
from hapsim.device.sockets import connected_socket, open_socket
from hapsim.errors import DeviceError, UsageError
from hapsim.loop.transport import PythonTransport, descriptor_transport
from hapsim.number_format import duration
from hapsim.scene.addresses import is_address

_PSEUDO_TERMINAL = re.compile(r"/dev/pts/\d+")


def free_name(name: Path | None) -> None:
    """Removes a link to a closed pseudo-terminal. Raises UsageError if anything else has that name."""
    if name is None or not os.path.lexists(name):
        return
    link = link_target(name)
    if link is None:
        raise UsageError(f"{name}: found a file, a directory or a device, expected a free name for the port")
    if os.path.exists(name) or not _PSEUDO_TERMINAL.fullmatch(link):
        raise UsageError(f"{name}: found a link to {link}, expected a free name for the port; remove an unused link")
    with _link_errors(name):
        name.unlink()


@contextlib.contextmanager
def link_to(name: Path | None, port: str) -> Iterator[str]:
    """Makes `name` a link to `port` while open. Yields the link, or `port` without a name. A link that has changed
    since is not removed. Raises UsageError if no link can be made."""
    if name is None:
        yield port
        return
    free_name(name)
    with _link_errors(name):
        name.symlink_to(port)
    try:
        yield str(name)
    finally:
        if link_target(name) == port:
            name.unlink(missing_ok=True)


def open_pseudo_terminal(of: str, instead: str) -> tuple[int, int]:
    """Opens a pseudo-terminal. Returns its near and far end, raw before any program can open it, non-blocking.

    The far end must stay open: otherwise every close of a host would read as a hang-up. Raises DeviceError if the
    system has none left. `of`, `instead`: words of that error for the owner and for the alternative.
    """
    import tty

    try:
        ends = os.openpty()
    except OSError as error:
        raise DeviceError(
            f"no pseudo-terminal is available{of}: {error.strerror} (is /dev/pts mounted?). {instead}"
        ) from error
    for end in ends:
        tty.setraw(end)
        os.set_blocking(end, False)
    return ends


def link_target(name: str | Path) -> str | None:
    """Returns the target of a symbolic link; None if `name` is no link."""
    try:
        return os.readlink(name)
    except (OSError, ValueError):
        return None


@contextlib.contextmanager
def _link_errors(name: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{name}: this link cannot be made: {error.strerror}; choose a name in a directory of yours"
        ) from error


def state_directory() -> Path:
    """Returns $XDG_STATE_HOME/hapsim, by default under ~/.local/state. Raises OSError if the user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        return (Path(state) if os.path.isabs(state) else Path.home() / ".local" / "state") / "hapsim"
    except RuntimeError as error:
        message = "this user has no home: set XDG_STATE_HOME, or name a directory"
        raise FileNotFoundError(errno.ENOENT, message) from error


_PSEUDO_TERMINALS = range(136, 144)  # major numbers, Linux's Documentation/admin-guide/devices.txt
_PROC = Path("/proc")
_LONGEST = 120  # characters of a command line in a sentence
_LONGEST_STEP_S = 1e-4  # Windows' clock has 16 ms before Python 3.13
_WRITE_TIMEOUT_S = 1.0  # of the portable loop, whose interpreter may be held up for a tenth of a second


def open_serial_port(path: str, baud: int) -> Connection:
    """Opens a port at `baud` bit/s, or a socket at an address, for the compiled loop. Raises DeviceError, with the
    remedy, if that fails."""
    if is_address(path):
        return open_socket(path)
    port = _open(path, baud)
    _make_raw(port.fileno())
    return _connection(port, descriptor_transport(port.fileno()))


def require_fine_clock() -> None:
    """Raises UsageError if a step of Python's clock is too long for the loop in Python."""
    step_s = time.get_clock_info("monotonic").resolution
    if step_s > _LONGEST_STEP_S:
        raise UsageError(
            f"the clock of this Python has steps of {duration(step_s)}, expected {duration(_LONGEST_STEP_S)} at most: "
            "on Windows, use Python 3.13 or newer"
        )


def open_portable_port(path: str, baud: int) -> Connection:
    """Opens the same for the portable loop. Raises as `open_serial_port`."""
    from hapsim.loop.portable import PortableTransport

    require_fine_clock()
    if is_address(path):
        return open_socket(path)
    port = _open(path, baud)
    return _connection(port, PortableTransport(port))


def _connection(port: Any, transport: PythonTransport) -> Connection:
    note = "" if _set_low_latency(port) else "the port's driver offers no low-latency mode"
    return Connection(transport, port.port, port.close, baud=port.baudrate, note=note, behind_port=True)


@contextlib.contextmanager
def raw_port(path: str, baud: int) -> Iterator[int]:
    """Yields the descriptor of an open port: raw, locked, non-blocking; or that of a socket. Raises DeviceError with
    the remedy."""
    if is_address(path):
        with contextlib.closing(connected_socket(path)) as caller:
            yield caller.fileno()
        return
    with contextlib.closing(_open(path, baud)) as port:
        _make_raw(port.fileno())
        _set_low_latency(port)
        yield port.fileno()


def _open(path: str, baud: int) -> Any:
    import serial

    try:
        return serial.Serial(path, baud, timeout=0, write_timeout=_WRITE_TIMEOUT_S, exclusive=True)
    except (OSError, ValueError) as error:  # SerialException is an OSError
        raise DeviceError(_opening_error(path, baud, error)) from error


def serial_ports() -> list[dict[str, str]]:
    """Returns path, description and hardware of each serial port of this system."""
    from serial.tools import list_ports

    return [
        {"port": port.device, "description": port.description or "", "hardware": port.hwid or ""}
        for port in sorted(list_ports.comports())
    ]


def _make_raw(descriptor: int) -> None:
    """Sets VMIN = 1: an empty port then reads as EAGAIN, and only a hang-up as empty."""
    import fcntl
    import termios

    attributes = termios.tcgetattr(descriptor)
    attributes[6][termios.VMIN] = 1
    attributes[6][termios.VTIME] = 0
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    if os.major(os.fstat(descriptor).st_rdev) in _PSEUDO_TERMINALS:
        return  # the other side keeps it open: after TIOCEXCL only root could open it again
    with contextlib.suppress(OSError):
        fcntl.ioctl(descriptor, termios.TIOCEXCL)


def _set_low_latency(port: Any) -> bool:
    """Requests that the driver does not gather bytes (FTDI: 16 ms by default). Returns whether it can."""
    try:
        port.set_low_latency_mode(True)
    except (ValueError, OSError, AttributeError):
        return False
    return True


_BUSY = ("exclusively lock", "busy", "PermissionError(13, 'Access is denied.'")  # the last is Windows' message


def _opening_error(path: str, baud: int, error: Exception) -> str:
    code = getattr(error, "errno", None)
    text = str(error)
    if code == errno.ENOENT or "No such file" in text or "FileNotFoundError" in text:
        ports = ", ".join(port["port"] for port in serial_ports())
        found = f"Ports found: {ports or 'none'} (details: `hapsim ports`)"
        link = link_target(path)
        if link is not None:
            return f"{path}: a link to {link}, which is gone: was the program that made it stopped? {found}"
        return f"{path}: no such port. {found}"
    if code in (errno.EACCES, errno.EPERM) or "Permission denied" in text:
        return f"{path}: not permitted. On most systems: add yourself to the group dialout and log in again"
    if code in (errno.EAGAIN, errno.EBUSY) or any(word in text for word in _BUSY):
        holders = port_holders(path)
        which = f": {holders}. Close it" if holders else ". Close it (ModemManager is a frequent one)"
        return f"{path}: another program is using the port{which} and try again"
    if code in (errno.ENOTTY, errno.EISDIR) or "not configure port" in text or "Inappropriate ioctl" in text:
        for kind, is_kind in (("file", Path.is_file), ("directory", Path.is_dir)):
            if is_kind(Path(path)):
                return f"{path}: not a serial port, but a {kind}"
        return f"{path}: not a serial port, or one that cannot be set to {baud} baud"
    return f"{path}: cannot be opened: {text}"


def port_holders(path: str) -> str:
    """Returns the processes that hold `path`, as words after a colon; "" if none is found.

    Linux shows every lock to everyone, but open files only to their user and root.
    """
    try:
        port = os.stat(path)
    except (OSError, ValueError):
        return ""
    locking = [pid for pid in _lock_holders(port) if (_PROC / pid).exists()]
    if locking:
        return " and ".join(f"{_process_name(pid)} holds its lock" for pid in locking)
    return " and ".join(f"{_process_name(pid)} has it open" for pid in _open_holders(os.path.realpath(path)))


def _lock_holders(port: os.stat_result) -> list[str]:
    """Returns the processes with a lock on this file, from lines like `1: FLOCK ADVISORY WRITE 2461 00:1a:3 0 EOF`."""
    where = f"{os.major(port.st_dev):02x}:{os.minor(port.st_dev):02x}:{port.st_ino}"
    with contextlib.suppress(OSError):
        lines = map(str.split, (_PROC / "locks").read_text("ascii", "replace").splitlines())
        return [words[4] for words in lines if words[1:2] == ["FLOCK"] and words[5:6] == [where]]
    return []


def _open_holders(port: str) -> list[str]:
    """Returns the readable processes that have this file open."""
    found = []
    for process in _PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):  # another user's, or it has ended
            if any(os.readlink(one) == port for one in (process / "fd").iterdir()):
                found.append(process.name)
    return sorted(found, key=int)


def _process_name(process: str) -> str:
    if process == str(os.getpid()):
        return f"this process itself (PID {process})"
    command = ""
    with contextlib.suppress(OSError):
        command = (_PROC / process / "cmdline").read_text("utf-8", "replace").rstrip("\0").replace("\0", " ")
    command = "".join(one if one.isprintable() else "?" for one in command)
    command = f"{command[:_LONGEST]}…" if len(command) > _LONGEST else command
    return f"PID {process} ({command})" if command else f"PID {process}"
