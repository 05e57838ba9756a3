"""The devices that this user has pushed or run before: names in a file of the state directory."""

from __future__ import annotations

import contextlib
import errno
import os
from pathlib import Path


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
