"""All memory locked. For real it is tried in a process of its own, in test_realtime."""

from __future__ import annotations

import errno
import os
import resource
from collections.abc import Callable
from pathlib import Path

import pytest

from hapsim.loop.realtime import memory, privilege
from hapsim.loop.realtime.memory import memory_locked as locked

STATUS = "Name:\tVmLck: 1 kB\nVmSize:\t  350000 kB\nVmLck:\t  125000 kB\n"


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[object, ...]]:
    """What is called in a C library that grants everything, and in a process that spans 358.4 MB."""
    (tmp_path / "status").write_text(STATUS, encoding="utf-8")
    monkeypatch.setattr(memory, "_STATUS", tmp_path / "status")
    made: list[tuple[object, ...]] = []

    def call(*words: object) -> int:
        made.append(words)
        return 0

    monkeypatch.setattr(privilege, "call_c", call)
    return made


def test_what_there_is_is_locked_not_what_comes_later(calls: list[tuple[object, ...]]) -> None:
    with locked(1) as grant:
        assert calls == [("mlockall", 1)], "MCL_CURRENT alone"
    assert calls[1:] == [("munlockall",)]
    assert (grant.granted, grant.detail) == (True, "128 MB")


def test_what_is_locked_is_unlocked_even_where_nothing_tells_how_much(
    calls: list[tuple[object, ...]], tmp_path: Path
) -> None:
    (tmp_path / "status").unlink()
    with locked(1) as grant:
        pass
    assert calls[1:] == [("munlockall",)]
    assert (grant.granted, grant.detail) == (True, "all memory")


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("number", [errno.ENOMEM, errno.EPERM])
def test_who_is_refused_reads_how_much_was_wanted_what_is_allowed_and_what_it_takes(
    number: int, root: bool, refuse: Callable[[str, int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (65_536, 65_536))
    refuse("hapsim.loop.realtime.privilege.call_c", number)
    with locked(1) as grant:
        pass
    for words in ("358 MB", "0.0655 MB", os.strerror(number)):
        assert words in grant.detail
    assert ("limits.d" in grant.detail, "--cap-add" in grant.detail) == (not root, root)


@pytest.mark.usefixtures("calls")
def test_without_a_limit_no_limit_is_blamed(
    refuse: Callable[[str, int], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    refuse("hapsim.loop.realtime.privilege.call_c", errno.ENOMEM)
    with locked(1) as grant:
        assert "free some memory" in grant.detail
        assert "limits.d" not in grant.detail


def test_a_call_of_the_c_library_that_fails_raises_its_error() -> None:
    with pytest.raises(OSError, match="prctl") as caught:
        privilege.call_c("prctl", 0x7FFFFFFF)
    assert caught.value.errno == errno.EINVAL
