"""Work that gives way to a running loop: it is done, elsewhere, and whatever came of it comes back."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading

import pytest

from hapsim.loop.background import BackgroundWork


def test_what_comes_of_it_comes_back() -> None:
    assert BackgroundWork(lambda: 7).result() == 7
    failed = BackgroundWork(lambda: {}["lost"])
    for _ in range(2):
        with pytest.raises(KeyError, match="lost"):
            failed.result()


@pytest.mark.skipif(sys.platform != "linux", reason="a scheduling of Linux")
@pytest.mark.parametrize("idle_priority", [True, False])
def test_its_thread_alone_gives_way(idle_priority: bool) -> None:
    before = os.sched_getscheduler(0)
    policy, thread = BackgroundWork(lambda: (os.sched_getscheduler(0), threading.get_ident()), idle_priority).result()
    assert policy == (os.SCHED_IDLE if idle_priority else before)
    assert thread != threading.get_ident()
    assert os.sched_getscheduler(0) == before != os.SCHED_IDLE


def test_where_there_is_no_such_scheduling_it_is_done_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    assert BackgroundWork(lambda: 7).result() == 7
    monkeypatch.delattr(os, "sched_setscheduler")
    assert BackgroundWork(lambda: 7).result() == 7


def test_an_interrupt_ends_the_waiting_and_not_the_work() -> None:
    goes_on = threading.Event()
    work = BackgroundWork(lambda: goes_on.wait(60.0))
    threading.Timer(0.05, os.kill, (os.getpid(), signal.SIGINT)).start()
    with pytest.raises(KeyboardInterrupt):
        work.result()
    assert not work._future.done()
    goes_on.set()
    assert work.result()


@pytest.mark.parametrize(("seconds", "status"), [(60.0, 3), (0.0, 0)])
def test_a_program_that_ends_does_not_wait_for_it(seconds: float, status: int) -> None:
    """It ends with its own status, what it printed printed, and no complaint."""
    text = f"""
import time
from hapsim.loop.background import BackgroundWork, exit_with_unfinished
BackgroundWork(lambda: time.sleep({seconds}))
print("done")
exit_with_unfinished(3)
"""
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, check=False, timeout=30)
    assert (done.returncode, done.stdout, done.stderr) == (status, "done\n", "")
