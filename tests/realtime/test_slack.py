"""Timer slack, which goes without any privilege."""

from __future__ import annotations

import errno
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from hapsim.loop.realtime import PrivilegeResult, no_timer_slack, privilege

PR_SET_TIMERSLACK = 29
PR_GET_TIMERSLACK = 30


def slack_ns() -> int:
    """Of the thread that calls this, as the kernel has it."""
    return privilege.call_c("prctl", PR_GET_TIMERSLACK, 0, 0, 0, 0)


def test_the_thread_that_asks_has_no_slack_and_the_others_keep_theirs() -> None:
    before = slack_ns()

    def ask() -> tuple[PrivilegeResult, int, int]:
        return no_timer_slack(), slack_ns(), threading.get_native_id()

    with ThreadPoolExecutor(1) as pool:
        grant, inside, thread_id = pool.submit(ask).result()
    assert thread_id != threading.get_native_id()
    assert grant.granted is (inside <= 1)
    if grant.granted:
        assert grant == PrivilegeResult("timer slack", True, f"{inside} ns")
    assert slack_ns() == before


def test_where_all_is_granted_the_least_there_is_was_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    thread = {"slack": 50_000}

    def prctl(_name: str, option: int, value: int, *_rest: int) -> int:
        if option == PR_GET_TIMERSLACK:
            return thread["slack"]
        assert option == PR_SET_TIMERSLACK
        thread["slack"] = value or 50_000
        return 0

    monkeypatch.setattr(privilege, "call_c", prctl)
    assert no_timer_slack() == PrivilegeResult("timer slack", True, "1 ns")


def test_a_kernel_that_keeps_its_slack_is_not_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(privilege, "call_c", lambda _name, option, *_: 50_000 if option == PR_GET_TIMERSLACK else 0)
    grant = no_timer_slack()
    assert not grant.granted
    assert "50000 ns" in grant.detail


def test_whatever_the_error_is_it_is_denied_with_a_sentence(refuse: Callable[[str, int], None]) -> None:
    for number in errno.errorcode:
        refuse("hapsim.loop.realtime.privilege.call_c", number)
        grant = no_timer_slack()
        assert not grant.granted
        assert os.strerror(number) in grant.detail or number in (errno.ESRCH, errno.ENOSYS)
