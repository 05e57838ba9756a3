"""`hapsim …` as on a system that is not Linux, many times in one process (see answers.py).

What such a system lacks is taken away before anything is imported: modules of Python, functions of `os`, `time` and
`signal`, the system calls of the loop. They are gone for LLVM too, so that whatever is compiled all the same, or was
kept, ends the process at its first look for them. In place of pyserial, which does without only where the system says
that it is another one, stands a port behind which the mock of the scene answers, in memory.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import sys
import sysconfig
import time
import types
from typing import Any

import llvmlite.binding
from answers import answer_all

MODULES = ("crypt", "fcntl", "grp", "nis", "pty", "pwd", "resource", "spwd", "syslog", "termios", "tty")
CALLS = ("clock_gettime", "clock_nanosleep", "poll", "ppoll", "read", "write", "__errno_location")
FUNCTIONS: dict[Any, tuple[str, ...]] = {
    os: (
        *("fork", "forkpty", "geteuid", "mkfifo", "openpty", "set_blocking", "ttyname"),
        *(name for name in dir(os) if name.startswith(("sched_", "SCHED_", "posix_"))),
    ),
    time: tuple(name for name in dir(time) if name.startswith(("clock_", "CLOCK_"))),
    signal: ("SIGHUP",),
    socket: ("AF_UNIX",),
}


class Library(ctypes.CDLL):
    """A library of C; the system's own lacks what the loop calls."""

    def __getattr__(self, name: str) -> Any:
        if self._name is None and name in CALLS:
            raise AttributeError(name)
        return super().__getattr__(name)


class Serial:
    """A port as pyserial has it: the mock of the scene that is run, with a timer where it is asked for one."""

    scene = ""
    port_of = "COM3"

    def __init__(self, port: str, baudrate: int, *, timeout: float, **_options: Any) -> None:
        import numpy as np
        from timed_mock import TimedMock

        from hapsim.device.mock.assemble_mock import assemble_mock
        from hapsim.scene import load_scene

        if port not in (self.port_of, os.devnull):  # `frames` takes an existing file
            raise SerialException(f"could not open port {port!r}")
        self.port, self.baudrate, self.timeout = port, baudrate, timeout
        self._mock = assemble_mock(load_scene(self.scene))
        self._transport, self._bytes = TimedMock(self._mock), np.zeros(1 << 14, np.uint8)
        self._came = bytearray()

    @property
    def in_waiting(self) -> int:
        self._fetch(0.0)
        return len(self._came)

    def write(self, data: bytes) -> int:
        self._transport.send(data)
        return len(data)

    def read(self, size: int) -> bytes:
        if not self._came:
            self._fetch(self.timeout)
        data = bytes(self._came[:size])
        del self._came[:size]
        return data

    def close(self) -> None:
        if self._mock.board.state:
            print("The port was closed while the device was armed.", file=sys.stderr)

    def _fetch(self, timeout_s: float) -> None:
        count = max(self._transport.receive(self._bytes, round(timeout_s * 1e9)), 0)
        self._came += self._bytes[:count].tobytes()


class SerialException(OSError):  # noqa: N818
    """pyserial's own."""


class SerialTimeoutException(SerialException):
    """Timeout of a write."""


def pyserial() -> dict[str, types.ModuleType]:
    """Returns the modules of a pyserial without ports, by name."""
    serial, tools, ports = (types.ModuleType(name) for name in ("serial", "serial.tools", "serial.tools.list_ports"))
    found = types.SimpleNamespace(device=Serial.port_of, description="a port", hwid=None, serial_number=None)
    vars(serial).update(Serial=Serial, SerialException=SerialException, tools=tools)
    vars(serial).update(SerialTimeoutException=SerialTimeoutException)
    vars(ports).update(comports=lambda: [found])
    vars(tools).update(list_ports=ports)
    return {module.__name__: module for module in (serial, tools, ports)}


def become_another_system() -> None:
    sysconfig.get_config_vars()  # Python's own, found by the name of the system that it was built for
    sys.platform = "freebsd14"
    signal.SIGBREAK = signal.SIGUSR1  # type: ignore[attr-defined]
    sys.modules.update(dict.fromkeys(MODULES))
    for owner, names in FUNCTIONS.items():
        for name in names:
            delattr(owner, name)
    ctypes.CDLL = Library  # type: ignore[misc]
    for name in CALLS:
        llvmlite.binding.add_symbol(name, 0)
    sys.modules.update(pyserial())


def choose_mock(words: list[str]) -> None:
    """The port is that of the first scene among a command's words, or of the command before."""
    Serial.scene = next((word for word in words if word.endswith(".yaml")), Serial.scene)


if __name__ == "__main__":
    become_another_system()
    answer_all(choose_mock)
