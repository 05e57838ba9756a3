"""Names of ports: links that the user chose for a pseudo-terminal, and the devices that this user has met before.

A program that is killed leaves its link behind. Call `free_name` before opening a pseudo-terminal: the system reuses
the number of a closed one, and an old link would then seem to lead to a port in use.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
from collections.abc import Iterator
from pathlib import Path

from hapsim.errors import UsageError

_PSEUDO_TERMINAL = re.compile(r"/dev/pts/\d+")


def free_name(name: Path | None) -> None:
    """Removes a link to a closed pseudo-terminal. UsageError where the name is taken by anything else."""
    if name is None or not os.path.lexists(name):
        return
    link = leads_to(name)
    if link is None:
        raise UsageError(f"{name}: found a file, a directory or a device, expected a free name for the port")
    if os.path.exists(name) or not _PSEUDO_TERMINAL.fullmatch(link):
        raise UsageError(f"{name}: found a link to {link}, expected a free name for the port; remove an unused link")
    with _explained(name):
        name.unlink()


def give_name(name: Path, port: str) -> None:
    """Makes `name` a link to `port`. UsageError where that is not possible."""
    free_name(name)
    with _explained(name):
        name.symlink_to(port)


def take_name(name: Path, port: str) -> None:
    """Removes the link if it still leads to `port`."""
    if leads_to(name) == port:
        name.unlink(missing_ok=True)


@contextlib.contextmanager
def linked(name: Path | None, port: str) -> Iterator[str]:
    """Yields the port's name: the link `name` while open, or the port's own."""
    if name is None:
        yield port
        return
    give_name(name, port)
    try:
        yield str(name)
    finally:
        take_name(name, port)


def leads_to(name: str | Path) -> str | None:
    """Returns the target of a symbolic link; None where there is no link."""
    try:
        return os.readlink(name)
    except (OSError, ValueError):
        return None


@contextlib.contextmanager
def _explained(name: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        raise UsageError(
            f"{name}: this link cannot be made: {error.strerror}; choose a name in a directory of yours"
        ) from error


def state_directory() -> Path:
    """Returns $XDG_STATE_HOME/hapsim, by default under ~/.local/state. OSError where the user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        return (Path(state) if os.path.isabs(state) else Path.home() / ".local" / "state") / "hapsim"
    except RuntimeError as error:
        message = "this user has no home: set XDG_STATE_HOME, or name a directory"
        raise FileNotFoundError(errno.ENOENT, message) from error


def is_new(port: str) -> bool:
    """Returns whether this user meets the device at `port` for the first time, and remembers it.

    A device is known by its serial number, or else by the port's name. Where there is none, or nothing can be written,
    no device is new.
    """
    from serial.tools import list_ports

    if not os.path.exists(port):
        return False
    there = os.path.realpath(port)
    numbers = [one.serial_number for one in list_ports.comports() if os.path.realpath(one.device) == there]
    name = next(filter(None, numbers), port)
    with contextlib.suppress(OSError, UnicodeError):
        file = state_directory() / "devices"
        if file.exists() and name in file.read_text(encoding="utf-8").splitlines():
            return False
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a", encoding="utf-8") as known:
            known.write(f"{name}\n")
        return True
    return False
