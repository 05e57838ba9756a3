"""Ports: names for pseudo-terminals, the processes that hold a port, and the devices that were pushed or run before."""

from __future__ import annotations

import contextlib
import fcntl
import os
import subprocess
import sys
import termios
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapsim.device import ports
from hapsim.device.ports import free_name, link_to, open_serial_port, port_holders
from hapsim.errors import DeviceError, UsageError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")


@contextlib.contextmanager
def terminal() -> Iterator[str]:
    ends = os.openpty()
    try:
        yield os.ttyname(ends[1])
    finally:
        for end in ends:
            os.close(end)


def refusal(name: Path) -> str:
    with pytest.raises(UsageError) as caught:
        free_name(name)
    return str(caught.value).removeprefix(f"{name}: ")


def test_a_link_to_a_pseudo_terminal_that_is_gone_is_replaced(tmp_path: Path) -> None:
    name = tmp_path / "port"
    name.symlink_to("/dev/pts/99999")
    with terminal() as port, link_to(name, port) as named:
        assert (named, os.readlink(name)) == (str(name), port)
    assert not name.is_symlink()
    free_name(name)
    free_name(None)


def test_a_link_to_a_pseudo_terminal_that_is_there_stays(tmp_path: Path) -> None:
    name = tmp_path / "port"
    with terminal() as port:
        name.symlink_to(port)
        assert refusal(name) == (f"found a link to {port}, expected a free name for the port; remove an unused link")
        assert os.readlink(name) == port


def test_a_link_that_leads_elsewhere_by_now_stays(tmp_path: Path) -> None:
    name = tmp_path / "port"
    with terminal() as port, link_to(name, "/dev/pts/99999"):
        name.unlink()
        name.symlink_to(port)
    assert os.readlink(name) == port


@pytest.mark.parametrize(
    ("made", "told"),
    [
        (lambda name: name.write_text("mine"), "found a file, a directory or a device, expected a free name"),
        (lambda name: name.mkdir(), "found a file, a directory or a device, expected a free name"),
        (lambda name: name.symlink_to("/dev/ttyNOPE7"), "found a link to /dev/ttyNOPE7, expected a free name"),
        (lambda name: name.symlink_to("/dev/null"), "found a link to /dev/null, expected a free name"),
    ],
)
def test_what_is_no_link_of_ours_stays(tmp_path: Path, made, told: str) -> None:  # type: ignore[no-untyped-def]
    name = tmp_path / "port"
    made(name)
    before = os.lstat(name).st_ino
    assert refusal(name).startswith(told)
    assert os.lstat(name).st_ino == before


def test_a_name_where_no_link_can_be_made_is_reported_with_what_to_do(tmp_path: Path) -> None:
    told = "No such file or directory; choose a name in a directory of yours"
    with pytest.raises(UsageError, match=told), link_to(tmp_path / "none" / "port", "/dev/pts/99999"):
        pass


HOLDS = """
import sys, time
from hapsim.device.ports import open_serial_port
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


def test_without_a_lock_the_owners_of_the_port_are_named(by_id: str) -> None:
    assert port_holders(by_id) == f"this process itself (PID {os.getpid()}) has it open"


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
    monkeypatch.setattr(ports, "_PROC", tmp_path)
    assert port_holders(port) == "PID 7 (hapsim run my\N{REPLACEMENT CHARACTER}scene.yaml) holds its lock"
    monkeypatch.setattr(ports, "_PROC", tmp_path / "nowhere")
    assert port_holders(port) == ""
    assert port_holders(str(tmp_path / "nowhere")) == ""


def test_a_port_of_the_mock_is_open_to_the_next_who_is_not_root(port: str) -> None:
    """The mock's own side keeps the terminal open: exclusive mode would last and stop all users but root."""
    open_serial_port(port, 2_000_000).close()
    os.chmod(port, 0o666)
    user = {"user": 65534, "group": 65534, "extra_groups": []} if os.geteuid() == 0 else {}
    subprocess.run(["sh", "-c", 'exec 3<>"$0"', port], check=True, **user)


def test_a_port_that_is_no_pseudo_terminal_is_exclusive(port: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    ioctl = fcntl.ioctl
    monkeypatch.setattr("hapsim.device.ports._PSEUDO_TERMINALS", range(0))
    monkeypatch.setattr(fcntl, "ioctl", lambda *words: asked.append(words[1]) or ioctl(*words))
    open_serial_port(port, 2_000_000).close()
    assert termios.TIOCEXCL in asked
