"""A name for a pseudo-terminal: what was left over is replaced, what is somebody's stays, and is told as what it is."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hapsim.device.port_name import free_name, give_name, take_name
from hapsim.errors import UsageError

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
    with terminal() as port:
        give_name(name, port)
        assert os.readlink(name) == port
        take_name(name, port)
    assert not name.is_symlink()
    free_name(name)
    free_name(None)


def test_a_link_to_a_pseudo_terminal_that_is_there_stays(tmp_path: Path) -> None:
    name = tmp_path / "port"
    with terminal() as port:
        name.symlink_to(port)
        assert refusal(name) == (f"found a link to {port}, expected a free name for the port; remove an unused link")
        take_name(name, "/dev/pts/99999")
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


def test_a_name_where_no_link_can_be_made_is_told_with_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="No such file or directory; choose a name in a directory of yours"):
        give_name(tmp_path / "none" / "port", "/dev/pts/99999")
