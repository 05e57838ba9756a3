"""Motors that a test has shown to push the right way, by the serial number of their port and by channel.

`hapsim probe --push`, `hapsim identify` and the sign guard test a motor. hapsim keeps an empty file in its state
directory for each that is right: `motors/SERIAL.CHANNEL`. The name of a port is no identity. So what is known of a
motor at a port without a serial number, or where no file can be written, is known in this process only, and until the
port is unplugged.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from urllib.parse import quote

from hapsim.device.ports import state_directory

_in_this_process: set[tuple[str, int]] = set()


def serial_number(port: str) -> str:
    """Returns the serial number of a port's hardware; "" if it has none."""
    from serial.tools import list_ports

    there = os.path.realpath(port)
    numbers = (one.serial_number for one in list_ports.comports() if os.path.realpath(one.device) == there)
    return next((number.strip() for number in numbers if number), "")


def known_motors(port: str, channels: Sequence[int]) -> frozenset[int]:
    """Returns those of these channels of a device whose motors are known to push the right way."""
    number = serial_number(port)
    known = {channel for channel in channels if (_identity(port, number), channel) in _in_this_process}
    with contextlib.suppress(OSError):
        known |= {channel for channel in channels if number and _file(number, channel).exists()}
    return frozenset(known)


def note_motors(port: str | None, channels: Iterable[int], *, are_right: bool) -> None:
    """Keeps that the motors of these channels push the right way, or forgets it. `port`: None for the mock."""
    if port is None:
        return
    number = serial_number(port)
    for channel in channels:
        own, is_kept = (_identity(port, number), channel), False
        with contextlib.suppress(OSError):
            file = _file(number, channel)
            if not are_right:
                file.unlink(missing_ok=True)
            elif number:
                file.parent.mkdir(parents=True, exist_ok=True)
                file.touch()
                is_kept = True
        (_in_this_process.add if are_right and not is_kept else _in_this_process.discard)(own)


def _identity(port: str, number: str) -> str:
    """Returns the serial number, or the port as long as it is not unplugged: then its file is another one."""
    there = os.path.realpath(port)
    with contextlib.suppress(OSError):  # a COM port is no file
        there += " {0.st_ino} {0.st_ctime_ns}".format(os.stat(there))
    return number or there


def _file(number: str, channel: int) -> Path:
    return state_directory() / "motors" / f"{quote(number, safe='')}.{channel}"
