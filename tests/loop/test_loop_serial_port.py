"""Ports that cannot be opened: a sentence that says what to do."""

from __future__ import annotations

import contextlib
import errno
import os
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import serial

from hapsim.device.ports import open_serial_port, serial_ports
from hapsim.errors import DeviceError
from hapsim.loop.endings import HUNG_UP, TIMED_OUT

BAUD = 2_000_000


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """(descriptor of the near end, path of the port)"""
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
    yield near, os.ttyname(far)
    for end in (near, far):
        with contextlib.suppress(OSError):
            os.close(end)


def refusal(path: str) -> str:
    with pytest.raises(DeviceError) as caught:
        open_serial_port(path, BAUD)
    assert caught.value.exit_status == 3
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    assert "\n" not in text
    return text


def test_a_port_that_does_not_exist_is_reported_with_the_ports_that_do() -> None:
    assert "no such port. Ports found: " in refusal("/dev/ttyNOPE7")


def test_a_link_to_a_port_that_is_gone_is_reported_as_what_it_is(tmp_path: Path) -> None:
    link = tmp_path / "dev"
    link.symlink_to("/dev/pts/99999")
    told = refusal(str(link))
    assert "a link to /dev/pts/99999, which is gone: was the program that made it stopped? Ports found: " in told


@pytest.mark.parametrize(
    ("make", "told"), [(Path.touch, ", but a file"), (Path.mkdir, ", but a directory"), (os.mkfifo, "")]
)
def test_what_is_no_terminal_is_no_serial_port(tmp_path: Path, make: Callable[[Path], object], told: str) -> None:
    make(tmp_path / "there")
    assert f"{tmp_path / 'there'}: not a serial port{told}" in refusal(str(tmp_path / "there"))


@pytest.mark.parametrize("path", ["/dev/null", "/dev/zero", "/dev/full"])
def test_a_device_that_is_no_terminal_is_no_serial_port(path: str) -> None:
    assert refusal(path) == f"{path}: not a serial port, or one that cannot be set to {BAUD} baud"


def test_a_port_that_is_in_use_is_reported_as_such(terminal: tuple[int, str]) -> None:
    connection = open_serial_port(terminal[1], BAUD)
    try:
        assert "another program is using the port" in refusal(terminal[1])
    finally:
        connection.close()
    open_serial_port(terminal[1], BAUD).close()


DIALOUT = "not permitted. On most systems: add yourself to the group dialout"


@pytest.mark.parametrize(
    ("refusal_of", "told"),
    [
        (errno.EACCES, DIALOUT),
        (errno.EPERM, "not permitted"),
        (errno.EBUSY, "another program is using the port"),
        (errno.EIO, "cannot be opened: "),
        # On Windows pyserial's error has no number, only the words of the system's own.
        ("FileNotFoundError(2, 'The system cannot find the file specified.', None, 2)", "no such port. Ports found: "),
        ("PermissionError(13, 'Access is denied.', None, 5)", "another program is using the port"),
        ("OSError(22, 'A device attached to the system is not functioning.', None, 31)", "cannot be opened: "),
    ],
)
def test_a_refusal_is_reported_with_what_to_do(
    monkeypatch: pytest.MonkeyPatch, refusal_of: int | str, told: str
) -> None:
    """Root is refused nothing, so the system's answer is put in its mouth, in the words of pyserial."""

    def refuse(path: str, *_args: object, **_options: object) -> None:
        if isinstance(refusal_of, str):
            raise serial.SerialException(f"could not open port {path!r}: {refusal_of}")
        words = f"[Errno {refusal_of}] {os.strerror(refusal_of)}"
        raise serial.SerialException(refusal_of, f"could not open port {path}: {words}")

    monkeypatch.setattr(serial, "Serial", refuse)
    assert told in refusal("/dev/ttyACM0" if isinstance(refusal_of, int) else "COM3")


def test_an_empty_name_is_no_port() -> None:
    assert refusal("")


def test_what_is_sent_arrives_unchanged_in_both_directions(terminal: tuple[int, str]) -> None:
    """Raw: no byte means anything to the terminal, none is echoed."""
    near, path = terminal
    every = np.arange(256, dtype=np.uint8)
    connection = open_serial_port(path, BAUD)
    port = connection.transport
    try:
        assert port.send(every.tobytes()) == 0
        assert os.read(near, 1000) == every.tobytes()
        os.write(near, every.tobytes())
        buffer = np.zeros(1000, np.uint8)
        assert port.receive(buffer, 10**9) == 256
        assert buffer[:256].tolist() == every.tolist()
        assert port.receive(buffer, 0) == TIMED_OUT
        os.close(near)
        assert port.receive(buffer, 10**9) == HUNG_UP
        assert port.send(b"x") == HUNG_UP
    finally:
        connection.close()


def test_a_port_without_a_low_latency_mode_is_noted(terminal: tuple[int, str]) -> None:
    connection = open_serial_port(terminal[1], BAUD)
    connection.close()
    assert connection.note == "the port's driver offers no low-latency mode"
    assert connection.baud == BAUD


def test_the_ports_found_have_names() -> None:
    assert all(set(port) == {"port", "description", "hardware"} for port in serial_ports())
