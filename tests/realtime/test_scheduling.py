"""The loop's thread before all others, as high as the system lets it."""

from __future__ import annotations

import errno
import os
from collections.abc import Callable

import pytest

from hapsim.loop.realtime.scheduling import PRIORITY
from hapsim.loop.realtime.scheduling import scheduled_fifo as fifo

Policy = tuple[int, int]


class Scheduler:
    """A system with one thread, which grants priorities up to `most`."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, most: int, now: Policy = (os.SCHED_OTHER, 0)) -> None:
        self.most, self.now = most, now
        monkeypatch.setattr(os, "sched_getscheduler", lambda _: self.now[0])
        monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(self.now[1]))
        monkeypatch.setattr(os, "sched_setscheduler", self.set)

    def set(self, _thread_id: int, policy: int, parameters: os.sched_param) -> None:
        dropped_flag = self.now[0] & os.SCHED_RESET_ON_FORK & ~policy
        if parameters.sched_priority > self.most or dropped_flag:
            raise PermissionError(errno.EPERM, os.strerror(errno.EPERM))
        self.now = policy, parameters.sched_priority


def test_the_thread_is_scheduled_first_while_it_lasts_and_as_before_afterwards(thread_id: int) -> None:
    before = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id).sched_priority
    with fifo(thread_id) as grant:
        inside = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id).sched_priority
        assert os.sched_getscheduler(0) == before[0], "this thread is not the loop's"
    assert (inside == (os.SCHED_FIFO, PRIORITY)) is (grant.granted and grant.detail == f"priority {PRIORITY}")
    assert (os.sched_getscheduler(thread_id), os.sched_getparam(thread_id).sched_priority) == before


def test_where_all_is_granted_it_is_the_priority_that_was_chosen(monkeypatch: pytest.MonkeyPatch) -> None:
    system = Scheduler(monkeypatch, most=99)
    with fifo(1) as grant:
        assert system.now == (os.SCHED_FIFO, PRIORITY)
    assert (grant.granted, grant.detail) == (True, f"priority {PRIORITY}")
    assert system.now == (os.SCHED_OTHER, 0)


@pytest.mark.parametrize("most", [1, 2, 10, PRIORITY - 1])
def test_a_lower_priority_than_was_asked_for_is_taken_and_reported(most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    system = Scheduler(monkeypatch, most)
    with fifo(1) as grant:
        assert system.now == (os.SCHED_FIFO, most)
    assert grant.granted
    assert grant.detail.startswith(f"priority {most}, ")
    assert f"rtprio {PRIORITY}" in grant.detail
    assert system.now == (os.SCHED_OTHER, 0)


def test_who_stood_higher_already_is_not_lowered(monkeypatch: pytest.MonkeyPatch) -> None:
    system = Scheduler(monkeypatch, most=99, now=(os.SCHED_FIFO, 95))
    with fifo(1) as grant:
        assert system.now == (os.SCHED_FIFO, 95)
    assert grant.detail == "priority 95"


def test_a_flag_that_may_not_be_dropped_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    before = (os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, 0)
    system = Scheduler(monkeypatch, most=99, now=before)
    with fifo(1) as grant:
        assert system.now == (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY)
    assert grant.granted
    assert system.now == before


def test_who_is_refused_reads_what_it_takes(root: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    system = Scheduler(monkeypatch, most=0)
    with fifo(1) as grant:
        assert system.now == (os.SCHED_OTHER, 0)
    assert not grant.granted
    assert os.strerror(errno.EPERM) in grant.detail
    assert ("limits.d" in grant.detail, "--cap-add" in grant.detail) == (not root, root)


@pytest.mark.usefixtures("root")
def test_an_error_that_no_right_would_cure_is_named_without_advice(
    thread_id: int, refuse: Callable[[str, int], None]
) -> None:
    refuse("os.sched_setscheduler", errno.EINVAL)
    with fifo(thread_id) as grant:
        assert grant.detail == f"priority {PRIORITY} was refused ({os.strerror(errno.EINVAL)})"
