"""Asking for everything: whatever the system says, the run goes on, and afterwards all is as it was."""

from __future__ import annotations

import contextlib
import errno
import gc
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import pytest

import hapsim.loop.realtime as room
from hapsim.loop.realtime import Measure, PrivilegeResult, measure, pin_to_cpu, realtime, remove_timer_slack
from hapsim.loop.realtime import disable_idle_states as awake
from hapsim.loop.realtime import lock_memory as locked
from hapsim.loop.realtime import use_fifo as fifo

Refuse = Callable[[str, int], None]
# What each measure that can be refused is refused by.
CALLS = {
    "memory locked": (locked, "hapsim.loop.realtime.call_c"),
    "power saving off": (awake, "os.open"),
    "one processor": (pin_to_cpu, "os.sched_setaffinity"),
    "SCHED_FIFO": (fifo, "os.sched_setscheduler"),
}


@pytest.mark.parametrize("name", CALLS)
@pytest.mark.usefixtures("root")
def test_whatever_the_error_is_a_measure_is_denied_with_a_sentence(
    name: str, thread_id: int, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    ask, function = CALLS[name]
    monkeypatch.setattr(room, "_mapped_bytes", lambda: 0)
    for number in [*errno.errorcode][::5]:
        refuse(function, number)
        with ask(thread_id) as grant:
            pass
        assert (grant.privilege, grant.granted) == (name, False)
        assert len(grant.detail) > 20
        assert not grant.detail.endswith(".")


def test_elsewhere_each_measure_states_that_only_linux_has_it(thread_id: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gc, "collect", lambda: 0)  # of all that the other tests made
    for missing in ("sched_setscheduler", "sched_getscheduler", "sched_getparam", "sched_setaffinity"):
        monkeypatch.delattr(os, missing)
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr("sys.platform", "darwin")
    with realtime(thread_id) as grants:
        denied = {grant.privilege: grant.detail for grant in [*grants, remove_timer_slack()] if not grant.granted}
        assert gc.isenabled() is False
    assert denied == dict.fromkeys([*CALLS, "timer slack"], "only Linux has it")


# In a process of its own: locking what a test's process has mapped takes memory from all the others.
WHOLE = """
import contextlib, gc, os, pwd, resource, sys, threading
from pathlib import Path
from hapsim.loop.realtime import realtime

if sys.argv[1] == "nobody":
    with contextlib.suppress(PermissionError):  # already an unprivileged user
        os.setgroups([])
        os.setgid(65534)
        os.setuid(65534)

end = threading.Event()
thread = threading.Thread(target=end.wait, daemon=True)
thread.start()
id = thread.native_id

def is_open(path):
    # What /proc tells of open files is not for a process that changed its user.
    device = os.stat(path).st_rdev if os.path.exists(path) else None
    for descriptor in range(100):
        with contextlib.suppress(OSError):
            if os.fstat(descriptor).st_rdev == device:
                return True
    return False

def state():
    locked = Path("/proc/self/status").read_text().partition("VmLck:")[2].split()[0]
    return {
        "SCHED_FIFO": (os.sched_getscheduler(id), os.sched_getparam(id).sched_priority),
        "one processor": (os.sched_getaffinity(id), os.sched_getaffinity(0)),
        "garbage collector frozen": (gc.isenabled(), gc.get_freeze_count() > 0),
        "memory locked": int(locked) > 0,
        "power saving off": is_open("/dev/cpu_dma_latency"),
    }

before = state()
failure = ValueError("the body's own")
try:
    with realtime(id) as grants:
        inside = state()
        raise failure
except ValueError as caught:
    assert caught is failure
after = state()

assert after == before, (before, after)
assert {grant.privilege for grant in grants} == set(before)
for grant in grants:
    print(grant)
    alone = grant.privilege == "one processor" and len(before["one processor"][0]) == 1
    changed = inside[grant.privilege] != before[grant.privilege]
    assert changed == (grant.granted and not alone), (grant, before, inside)
assert not {"numba", "numpy", "rich"} & set(sys.modules)
print("well")
"""


@pytest.mark.parametrize("who", ["this user", "nobody"])
def test_what_is_reported_as_granted_has_happened_and_what_is_denied_has_not(who: str) -> None:
    done = subprocess.run([sys.executable, "-c", WHOLE, who], capture_output=True, text=True, check=False, timeout=100)
    assert done.stdout.endswith("well\n"), done.stdout + done.stderr


def named(name: str, told: list[str], undo: Callable[[], object] = lambda: None) -> Measure:
    """A measure that tells when it is asked for and undone."""

    def ask(_thread_id: int) -> Iterator[str]:
        told.append(f"{name} asked")
        yield "all of it"
        told.append(f"{name} undone")
        undo()

    return measure(name, str)(ask)


def fail() -> None:
    raise OSError(errno.EPERM, "no way back")


def defect() -> None:
    raise RuntimeError("not the body's")


@pytest.mark.parametrize("undo", [fail, defect])
def test_an_undoing_that_fails_stops_no_other(undo: Callable[[], None], monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []
    measures = (named("one", told), named("two", told, undo), named("three", told))
    monkeypatch.setattr(room, "_MEASURES", measures)
    with pytest.raises(ValueError, match="the body's own") as caught, realtime(1):
        raise ValueError("the body's own")
    assert caught.value.__context__ is None
    assert told == ["one asked", "two asked", "three asked", "three undone", "two undone", "one undone"]


def test_what_was_granted_is_given_back_when_asking_for_the_next_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    @contextlib.contextmanager
    def broken(_thread_id: int) -> Iterator[PrivilegeResult]:
        raise RuntimeError("a defect")
        yield

    told: list[str] = []
    monkeypatch.setattr(room, "_MEASURES", (named("one", told), broken))
    with pytest.raises(RuntimeError), realtime(1):
        pass
    assert told == ["one asked", "one undone"]


def test_the_failure_of_a_body_does_not_carry_the_refusal_along(refuse: Refuse) -> None:
    refuse("os.open", errno.EPERM)
    with pytest.raises(ValueError, match="the body's own") as caught, awake(1):
        raise ValueError("the body's own")
    assert caught.value.__context__ is None


def test_a_thread_may_end_before_the_undoing() -> None:
    script = (
        "import threading; from hapsim.loop.realtime import realtime\n"
        "end = threading.Event(); thread = threading.Thread(target=end.wait, daemon=True)\n"
        "thread.start()\n"
        "with realtime(thread.native_id): end.set(); thread.join()\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False, timeout=100)
    assert (done.returncode, done.stderr) == (0, "")


def test_of_two_loops_the_second_is_denied_and_leaves_the_first_what_it_has(
    refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse("hapsim.loop.realtime.call_c", errno.EPERM)  # locks no memory of this process
    monkeypatch.setattr(gc, "collect", lambda: 0)
    was_enabled = gc.isenabled()
    with realtime(threading.get_native_id()):
        with realtime(threading.get_native_id()) as second:
            assert [grant.granted for grant in second] == [False]
            assert "another loop" in second[0].detail
        assert not gc.isenabled()
    assert gc.isenabled() == was_enabled
