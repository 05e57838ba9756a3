"""Each measure alone: what it requests, what it reports, and that it leaves everything as it was."""

from __future__ import annotations

import errno
import math
import os
import pwd
import resource
import subprocess
import sys
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from hapsim.loop import realtime
from hapsim.loop.realtime import (
    PRIORITY,
    PrivilegeResult,
    disable_idle_states,
    lock_memory,
    login_limit,
    remove_timer_slack,
    use_fifo,
)
from hapsim.system_files import SystemFiles

Refuse = Callable[[str, int], None]

# The garbage collector, in a process of its own: what other tests have made is a second of its work each time.
COLLECTED = """
import gc, itertools
from hapsim.loop.realtime import freeze_collector

for enabled, was_frozen in itertools.product((True, False), repeat=2):
    (gc.freeze if was_frozen else gc.unfreeze)()
    (gc.enable if enabled else gc.disable)()
    before = gc.get_freeze_count()
    made_since = [[] for _ in range(1000)]
    with freeze_collector(1) as grant:
        assert not gc.isenabled()
        assert gc.get_freeze_count() > 0
    assert grant.granted
    assert gc.isenabled() is enabled
    assert (gc.get_freeze_count() > 0) is was_frozen
    assert gc.get_freeze_count() < before + len(made_since), "nothing was added to what somebody else set aside"

class Ring:
    def __init__(self):
        self.itself = self  # so that only the collector finds it
    def __del__(self):
        freed.append(True)

gc.disable()
freed = []
Ring()
assert not freed
with freeze_collector(1):
    assert freed == [True], "garbage is collected before the rest is set aside"
"""


def test_nothing_is_collected_while_it_lasts_and_afterwards_all_is_as_it_was() -> None:
    done = subprocess.run([sys.executable, "-c", COLLECTED], capture_output=True, text=True, check=False, timeout=100)
    assert (done.returncode, done.stderr) == (0, "")


# The limits that are set at login.


@pytest.mark.parametrize("name", ["ada", None])
def test_the_line_names_the_user_if_there_is_one(monkeypatch: pytest.MonkeyPatch, name: str | None) -> None:
    def entry(number: int) -> pwd.struct_passwd:
        if name is None:
            raise KeyError("getpwuid(): uid not found")
        return pwd.struct_passwd((name, "x", number, number, "", "/home", "/bin/sh"))

    monkeypatch.setattr(pwd, "getpwuid", entry)
    assert f"'{name or '*'} - rtprio 80' in /etc/security/limits.d/" in login_limit("rtprio", "80")


# Memory. For real it is locked in a process of its own, in test_realtime.


STATUS = "Name:\tVmLck: 1 kB\nVmSize:\t  350000 kB\nVmLck:\t  125000 kB\n"


@pytest.fixture
def calls(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[tuple[object, ...]]:
    """Calls to a C library that grants everything, from a process of 358.4 MB."""
    (tmp_path / "proc/self").mkdir(parents=True)
    (tmp_path / "proc/self/status").write_text(STATUS, encoding="utf-8")
    (tmp_path / "proc/self/maps").write_text("0-10000000 rw-p 0 0 0\n20000000-90000000 ---p 0 0 0\n", encoding="utf-8")
    monkeypatch.setattr(realtime, "SYSTEM", SystemFiles(tmp_path))
    made: list[tuple[object, ...]] = []

    def call(*words: object) -> int:
        made.append(words)
        return 0

    monkeypatch.setattr(realtime, "call_c", call)
    return made


@pytest.mark.parametrize(("is_told", "detail"), [(True, "128 MB"), (False, "all memory")])
def test_mapped_memory_is_locked(calls: list[tuple[object, ...]], tmp_path: Path, is_told: bool, detail: str) -> None:
    if not is_told:
        (tmp_path / "proc/self/status").unlink()
    with lock_memory(1) as grant:
        assert calls == [("mlockall", 1)], "MCL_CURRENT alone"
    assert calls[1:] == [("munlockall",)]
    assert (grant.granted, grant.detail) == (True, detail)


def test_more_than_the_control_group_has_is_not_locked(
    calls: list[tuple[object, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel would kill the process without a word."""
    monkeypatch.setattr(realtime, "memory_limit", lambda: 25e6)
    with lock_memory(1) as grant:
        assert not grant.granted
    assert calls == []
    assert "its control group has 25 MB, locking takes 268" in grant.detail
    assert "MemoryMax=" in grant.detail


@pytest.mark.parametrize(
    ("groups", "limits", "expected"),
    [
        ("0::/a/b", {"a/b/memory.max": "max", "a/memory.max": "250000000"}, 250e6),
        ("0::/", {"memory.max": "300000000"}, 300e6),  # a container sees its own group at the top
        ("4:cpu:/x\n3:memory:/a", {"memory/a/memory.limit_in_bytes": "250000000"}, 250e6),
        ("4:memory:/of/the/host", {"memory/memory.limit_in_bytes": "250000000"}, 250e6),
        ("0::/a", {}, math.inf),
        ("", {}, math.inf),
    ],
)
def test_the_smallest_limit_of_a_control_group_and_those_above_counts(
    tmp_path: Path, groups: str, limits: dict[str, str], expected: float
) -> None:
    for name, text in (
        {"proc/self/cgroup": groups} | {f"sys/fs/cgroup/{name}": text for name, text in limits.items()}
    ).items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{text}\n", encoding="utf-8")
    assert realtime.memory_limit(SystemFiles(tmp_path)) == expected


@pytest.mark.usefixtures("calls")
@pytest.mark.parametrize("number", [errno.ENOMEM, errno.EPERM])
def test_a_refusal_states_how_much_was_wanted_and_what_it_takes(
    number: int, root: bool, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (65_536, 65_536))
    refuse("hapsim.loop.realtime.call_c", number)
    with lock_memory(1) as grant:
        pass
    for words in ("358 MB", "0.0655 MB", os.strerror(number)):
        assert words in grant.detail
    assert ("limits.d" in grant.detail, "--cap-add" in grant.detail) == (not root, root)


@pytest.mark.usefixtures("calls")
def test_without_a_limit_no_limit_is_blamed(refuse: Refuse, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(resource, "getrlimit", lambda _: (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
    refuse("hapsim.loop.realtime.call_c", errno.ENOMEM)
    with lock_memory(1) as grant:
        assert "free some memory" in grant.detail
        assert "limits.d" not in grant.detail


def test_a_call_of_the_c_library_that_fails_raises_its_error() -> None:
    with pytest.raises(OSError, match="prctl") as caught:
        realtime.call_c("prctl", 0x7FFFFFFF)
    assert caught.value.errno == errno.EINVAL


# CPU idle states, off for as long as the device file is open.


@pytest.fixture
def device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file in the device's place, which anybody may write."""
    path = tmp_path / "cpu_dma_latency"
    path.touch()
    monkeypatch.setattr(realtime, "_DEVICE", str(path))
    return path


def open_files() -> list[str]:
    """The files that this process has open now."""
    files = Path("/proc/self/fd")
    return [os.path.realpath(files / name) for name in os.listdir(files)]


def test_zero_is_written_and_the_file_held_open_while_it_lasts(device: Path) -> None:
    with disable_idle_states(1) as grant:
        assert device.read_bytes() == bytes(4)
        assert str(device) in open_files()
    assert grant.granted
    assert str(device) not in open_files()


@pytest.mark.usefixtures("root")
def test_a_file_that_takes_nothing_is_closed_again(device: Path, refuse: Refuse) -> None:
    refuse("os.write", errno.EIO)
    with disable_idle_states(1) as grant:
        assert str(device) not in open_files()
    assert not grant.granted
    assert grant.detail == f"{device} failed ({os.strerror(errno.EIO)})"


def test_a_system_without_the_device_reports_it(device: Path) -> None:
    device.unlink()
    with disable_idle_states(1) as grant:
        assert f"there is no {device}" in grant.detail
    assert not grant.granted


@pytest.mark.parametrize("number", [errno.EACCES, errno.EPERM])
def test_who_may_not_write_it_reads_what_it_takes(number: int, root: bool, refuse: Refuse) -> None:
    refuse("os.open", number)
    with disable_idle_states(1) as grant:
        pass
    assert not grant.granted
    assert os.strerror(number) in grant.detail
    assert ("udev" in grant.detail, "container" in grant.detail) == (not root, root)


# The loop's thread before all others.


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
    with use_fifo(thread_id) as grant:
        inside = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id).sched_priority
        assert os.sched_getscheduler(0) == before[0], "this thread is not the loop's"
    assert (inside == (os.SCHED_FIFO, PRIORITY)) is (grant.granted and grant.detail == f"priority {PRIORITY}")
    assert (os.sched_getscheduler(thread_id), os.sched_getparam(thread_id).sched_priority) == before


RESET = os.SCHED_RESET_ON_FORK


@pytest.mark.parametrize(
    ("most", "before", "priority"),
    [
        *((most, (os.SCHED_OTHER, 0), min(most, PRIORITY)) for most in (99, PRIORITY - 1, 10, 2, 1)),
        (99, (os.SCHED_FIFO, 95), 95),  # one that stands higher already is not lowered
        (99, (os.SCHED_OTHER | RESET, 0), PRIORITY),  # a flag that may not be dropped is kept
    ],
)
def test_the_highest_priority_is_granted(
    most: int, before: Policy, priority: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = Scheduler(monkeypatch, most, before)
    with use_fifo(1) as grant:
        assert system.now == (os.SCHED_FIFO | before[0] & RESET, priority)
    assert grant.granted
    assert grant.detail.partition(",")[0] == f"priority {priority}"
    assert (f"rtprio {PRIORITY}" in grant.detail) == (priority < PRIORITY)
    assert system.now == before


def test_who_is_refused_reads_what_it_takes(root: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    system = Scheduler(monkeypatch, most=0)
    with use_fifo(1) as grant:
        assert system.now == (os.SCHED_OTHER, 0)
    assert not grant.granted
    assert os.strerror(errno.EPERM) in grant.detail
    assert ("limits.d" in grant.detail, "--cap-add" in grant.detail) == (not root, root)


@pytest.mark.usefixtures("root")
def test_an_error_that_no_right_would_cure_is_named_without_advice(thread_id: int, refuse: Refuse) -> None:
    refuse("os.sched_setscheduler", errno.EINVAL)
    with use_fifo(thread_id) as grant:
        assert grant.detail == f"priority {PRIORITY} was refused ({os.strerror(errno.EINVAL)})"


# Timer slack, which goes without any privilege.


PR_GET_TIMERSLACK = 30


def slack_ns() -> int:
    """Returns the calling thread's timer slack from the kernel."""
    return realtime.call_c("prctl", PR_GET_TIMERSLACK, 0, 0, 0, 0)


def test_the_thread_that_asks_has_no_slack_and_the_others_keep_theirs() -> None:
    before = slack_ns()

    def ask() -> tuple[PrivilegeResult, int, int]:
        return remove_timer_slack(), slack_ns(), threading.get_native_id()

    with ThreadPoolExecutor(1) as pool:
        grant, inside, thread_id = pool.submit(ask).result()
    assert thread_id != threading.get_native_id()
    assert grant.granted is (inside <= 1)
    if grant.granted:
        assert grant == PrivilegeResult("timer slack", True, f"{inside} ns")
    assert slack_ns() == before


def test_whatever_the_error_is_it_is_denied_with_a_sentence(refuse: Refuse) -> None:
    for number in errno.errorcode:
        refuse("hapsim.loop.realtime.call_c", number)
        grant = remove_timer_slack()
        assert not grant.granted
        assert os.strerror(number) in grant.detail
