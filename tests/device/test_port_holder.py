"""Of a port that is in use it is told who has it, as far as that was seen; nobody who is dead has one."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapsim.device import serial_port
from hapsim.device.serial_port import open_serial_port, who_holds
from hapsim.errors import DeviceError

HOLDS = """
import sys, time
from hapsim.device.serial_port import open_serial_port
held = open_serial_port(sys.argv[1], 2000000)
print("open", flush=True)
time.sleep(600)
"""


@pytest.fixture
def port() -> Iterator[str]:
    near, far = os.openpty()
    for end in (near, far):
        tty.setraw(end)
    yield os.ttyname(far)
    os.close(near)
    os.close(far)


@pytest.fixture
def by_id(port: str, tmp_path: Path) -> str:
    """The port by another name, as those of /dev/serial/by-id are."""
    link = tmp_path / "usb-device"
    link.symlink_to(port)
    return str(link)


def test_the_program_that_holds_a_port_is_named_and_killed_it_holds_nothing(port: str, by_id: str) -> None:
    command = [sys.executable, "-c", HOLDS, port, "a\x1b[2J scene"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as holder:
        try:
            assert holder.stdout is not None
            assert holder.stdout.readline() == "open\n"
            with pytest.raises(DeviceError) as refused:
                open_serial_port(by_id, 2_000_000)
            told = str(refused.value)
            assert told.startswith(
                f"{by_id}: another program is using the port: PID {holder.pid} ({sys.executable} -c "
            )
            assert told.endswith("holds its lock. Close it and try again")
            assert "\x1b" not in told
            assert "\n" not in told
        finally:
            holder.kill()
        holder.wait()
        open_serial_port(by_id, 2_000_000).close()


def test_without_a_lock_those_are_told_that_have_it_open(by_id: str) -> None:
    assert who_holds(by_id) == f"this process itself (PID {os.getpid()}) has it open"


def test_who_waits_for_a_lock_or_has_died_holds_no_port(
    port: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    status = os.stat(port)
    where = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino} 0 EOF"
    lines = [
        f"1: FLOCK  ADVISORY  WRITE 7 {where}",
        f"2: -> FLOCK  ADVISORY  WRITE 8 {where}",
        f"3: POSIX  ADVISORY  WRITE 8 {where}",
        f"4: FLOCK  ADVISORY  WRITE 9 {where}",
        "5: FLOCK  ADVISORY  WRITE 8 00:00:1 0 EOF",
        "nonsense",
    ]
    (tmp_path / "locks").write_text("\n".join(lines), encoding="ascii")
    for number in (7, 8):
        (tmp_path / str(number)).mkdir()
    (tmp_path / "7" / "cmdline").write_bytes(b"hapsim\0run\0my\xffscene.yaml\0")
    monkeypatch.setattr(serial_port, "_PROC", tmp_path)
    assert who_holds(port) == "PID 7 (hapsim run my\N{REPLACEMENT CHARACTER}scene.yaml) holds its lock"
    monkeypatch.setattr(serial_port, "_PROC", tmp_path / "nowhere")
    assert who_holds(port) == ""
    assert who_holds(str(tmp_path / "nowhere")) == ""


def test_a_port_of_the_mock_is_open_to_the_next_who_is_not_root(port: str) -> None:
    """Its other side keeps it open: what makes a terminal exclusive would stay for ever, and stop all but root."""
    open_serial_port(port, 2_000_000).close()
    os.chmod(port, 0o666)
    user = {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 else {}
    subprocess.run(["sh", "-c", 'exec 3<>"$0"', port], check=True, **user)


def test_a_port_that_is_no_pseudo_terminal_is_exclusive(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    ioctl = fcntl.ioctl
    monkeypatch.setattr("hapsim.device.serial_port._PSEUDO_TERMINALS", range(0))
    monkeypatch.setattr(fcntl, "ioctl", lambda *words: asked.append(words[1]) or ioctl(*words))
    open_serial_port(port, 2_000_000).close()
    assert termios.TIOCEXCL in asked
