"""Which devices this user has pushed or run before: names in a file of the state directory."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path


def state_directory() -> Path:
    """Where hapsim keeps what is no cache: $XDG_STATE_HOME/hapsim, by default under ~/.local/state. OSError where the
    user has no home."""
    state = os.environ.get("XDG_STATE_HOME", "")
    try:
        return (Path(state) if os.path.isabs(state) else Path.home() / ".local" / "state") / "hapsim"
    except RuntimeError as error:
        raise FileNotFoundError(
            errno.ENOENT, "this user has no home: set XDG_STATE_HOME, or name a directory"
        ) from error


def is_new(port: str) -> bool:
    """Returns whether this user meets the device at `port` for the first time, and remembers it.

    The device is known by its serial number, or else by the port's name. Where nothing is there, or nothing can be
    kept, no device is new.
    """
    if not os.path.exists(port):
        return False
    name = _serial_number(port) or port
    with contextlib.suppress(OSError, UnicodeError):
        file = state_directory() / "devices"
        if file.exists() and name in file.read_text(encoding="utf-8").splitlines():
            return False
        file.parent.mkdir(parents=True, exist_ok=True)
        with file.open("a", encoding="utf-8") as known:
            known.write(f"{name}\n")
        return True
    return False


def _serial_number(port: str) -> str:
    """ "" where it has none."""
    from serial.tools import list_ports

    there = os.path.realpath(port)
    found = (one.serial_number for one in list_ports.comports() if os.path.realpath(one.device) == there)
    return next(found, None) or ""
