"""Power saving off, for as long as the device file is open."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from hapsim.loop.realtime import scheduling as power
from hapsim.loop.realtime.scheduling import idle_states_off as awake


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file in the device's place, which anybody may write."""
    path = tmp_path / "cpu_dma_latency"
    path.touch()
    monkeypatch.setattr(power, "_DEVICE", str(path))
    return path


def open_files() -> list[str]:
    """The files that this process has open now."""
    files = Path("/proc/self/fd")
    return [os.path.realpath(files / name) for name in os.listdir(files)]


def test_zero_is_written_and_the_file_held_open_while_it_lasts(device: Path) -> None:
    with awake(1) as grant:
        assert device.read_bytes() == bytes(4)
        assert str(device) in open_files()
    assert grant.granted
    assert str(device) not in open_files()


@pytest.mark.usefixtures("root")
def test_a_file_that_takes_nothing_is_closed_again(device: Path, refuse: Callable[[str, int], None]) -> None:
    refuse("os.write", errno.EIO)
    with awake(1) as grant:
        assert str(device) not in open_files()
    assert not grant.granted
    assert grant.detail == f"{device} failed ({os.strerror(errno.EIO)})"


def test_a_system_without_the_device_says_so(device: Path) -> None:
    device.unlink()
    with awake(1) as grant:
        assert f"there is no {device}" in grant.detail
    assert not grant.granted


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
def test_who_may_not_write_it_reads_what_it_takes(number: int, root: bool, refuse: Callable[[str, int], None]) -> None:
    refuse("os.open", number)
    with awake(1) as grant:
        pass
    assert not grant.granted
    assert os.strerror(number) in grant.detail
    assert ("udev" in grant.detail, "container" in grant.detail) == (not root, root)
