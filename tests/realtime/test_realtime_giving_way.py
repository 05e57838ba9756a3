"""Work that gives way to a running loop: it is done, elsewhere, and whatever came of it comes back."""

from __future__ import annotations

import os
import sys
import threading

import pytest

from hapsim.realtime.giving_way import giving_way


def test_what_comes_of_it_comes_back() -> None:
    assert giving_way(lambda: 7) == 7
    with pytest.raises(KeyError, match="lost"):
        giving_way(lambda: {}["lost"])


@pytest.mark.skipif(sys.platform != "linux", reason="a scheduling of Linux")
def test_its_thread_alone_gives_way() -> None:
    before = os.sched_getscheduler(0)
    policy, thread = giving_way(lambda: (os.sched_getscheduler(0), threading.get_ident()))
    assert policy == os.SCHED_IDLE
    assert thread != threading.get_ident()
    assert os.sched_getscheduler(0) == before != os.SCHED_IDLE


def test_where_there_is_no_such_scheduling_it_is_done_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert giving_way(lambda: 7) == 7
    monkeypatch.delattr(os, "sched_setscheduler")
    assert giving_way(lambda: 7) == 7
