"""When the loop's thread runs: before all others, on a CPU of its own that does not idle, woken on time.

Where SCHED_FIFO is denied, another thread on the same CPU makes the loop wait for its whole time slice, some
milliseconds; where it is granted, the loop makes the other one wait. So the process's other threads leave the loop's
CPU, if there is another. SCHED_FIFO is safe because the loop sleeps in the kernel and never spins.
"""

from __future__ import annotations

import contextlib
import errno
import os
import struct
import sys
from collections.abc import Iterator
from pathlib import Path

from hapsim.loop.realtime import privilege
from hapsim.loop.realtime.privilege import ONLY_LINUX, PrivilegeResult, measure

PRIORITY = 80
"""Above 50, the priority of the kernel's interrupt threads: a loop that blocks does not delay them, and those of a disk
do not delay the loop. Below 99, that of the kernel's own watchdogs and migrations."""

_DEVICE = "/dev/cpu_dma_latency"
_ISOLATED = Path("/sys/devices/system/cpu/isolated")
_THREADS = Path("/proc/self/task")
_SLACK, _PR_SET_TIMERSLACK, _PR_GET_TIMERSLACK = "timer slack", 29, 30
_LEAST_SLACK_NS = 1  # 0 would mean the default


def _fifo_advice(error: OSError) -> str:
    refused = f"priority {PRIORITY} was refused ({error.strerror})"
    if not isinstance(error, PermissionError):
        return refused
    group = " and real-time runtime in the control group (cpu.rt_runtime_us)" if privilege.is_root() else ""
    return f"{refused}: it takes {privilege.what_grants('CAP_SYS_NICE', 'rtprio', str(PRIORITY))}{group}"


@measure("SCHED_FIFO", _fifo_advice)
def scheduled_fifo(thread_id: int) -> Iterator[str]:
    """SCHED_FIFO for the thread, at PRIORITY or at the highest that is granted below it; never lower than it was."""
    policy, parameters = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id)
    fifo = os.SCHED_FIFO | policy & os.SCHED_RESET_ON_FORK  # dropping this flag takes a privilege of its own
    priority = max(PRIORITY, parameters.sched_priority)
    while True:
        try:
            os.sched_setscheduler(thread_id, fifo, os.sched_param(priority))
            break
        except PermissionError:
            if priority == 1:
                raise
            priority -= 1
    more = f", the highest that was granted: {PRIORITY} takes {privilege.login_limit('rtprio', str(PRIORITY))}"
    yield f"priority {priority}{more if priority < PRIORITY else ''}"
    os.sched_setscheduler(thread_id, policy, parameters)


def _pin_advice(error: OSError) -> str:
    return (
        f"no single CPU could be chosen ({error.strerror}): `taskset -c 1 hapsim run …` chooses one from outside, and "
        "a control group (cpuset.cpus) or a container may forbid it"
    )


@measure("one processor", _pin_advice)
def pinned(thread_id: int) -> Iterator[str]:
    """Pins the thread to one CPU: one that is isolated from the scheduler, or the last that is allowed. The process's
    other threads leave it where they may run elsewhere."""
    allowed = os.sched_getaffinity(thread_id)
    cpu, detail = _pin(thread_id, allowed)
    moved = _clear(cpu)
    if moved:
        detail += f"; {len(moved)} other thread{'s' if len(moved) > 1 else ''} moved off it"
    yield detail
    for thread, cpus in (moved | {thread_id: allowed}).items():
        with contextlib.suppress(OSError):  # it has ended
            os.sched_setaffinity(thread, cpus)


def _pin(thread_id: int, allowed: set[int]) -> tuple[int, str]:
    """Pins the thread; returns its CPU, and the same in words."""
    # An isolated one is as a rule not among the allowed: that is what keeps all others off it.
    for cpu in sorted(_isolated(), key=lambda cpu: (cpu in allowed, cpu), reverse=True):
        with contextlib.suppress(OSError):
            os.sched_setaffinity(thread_id, {cpu})
            return cpu, f"CPU {cpu}, isolated from the scheduler"
    cpu = max(allowed)  # CPU 0 serves most interrupts
    os.sched_setaffinity(thread_id, {cpu})
    return cpu, f"CPU {cpu}" if len(allowed) > 1 else f"CPU {cpu}, the only one allowed: there was nothing to choose"


def _isolated() -> set[int]:
    """Returns the CPUs that the kernel keeps its scheduler off, as in ``2-3,6``; none where it does not say."""
    try:
        ranges = [part.split("-") for part in _ISOLATED.read_text(encoding="utf-8").strip().split(",") if part]
        return {cpu for ends in ranges for cpu in range(int(ends[0]), int(ends[-1]) + 1)}
    except (OSError, ValueError):
        return set()


def _clear(cpu: int) -> dict[int, set[int]]:
    """Moves the process's threads off `cpu`, if they may run elsewhere. Returns where they were allowed before."""
    moved = {}
    with contextlib.suppress(OSError):
        for thread in map(int, os.listdir(_THREADS)):
            with contextlib.suppress(OSError):  # it has ended, or has nowhere else to go
                before = os.sched_getaffinity(thread)
                if cpu in before:
                    os.sched_setaffinity(thread, before - {cpu})
                    moved[thread] = before
    return moved


def _idle_advice(error: OSError) -> str:
    if error.errno == errno.ENOENT:
        return f"there is no {_DEVICE}; a container needs --device={_DEVICE}, a kernel CONFIG_CPU_IDLE"
    if not isinstance(error, PermissionError):
        return f"{_DEVICE} failed ({error.strerror})"
    if privilege.is_root():
        return f"{_DEVICE} was refused to root ({error.strerror}): a container needs --device={_DEVICE}"
    return (
        f"{_DEVICE} may not be written ({error.strerror}): it takes a udev rule that gives it to a group of yours "
        '(KERNEL=="cpu_dma_latency", GROUP="…", MODE="0660" in /etc/udev/rules.d/hapsim.rules), or root'
    )


@measure("power saving off", _idle_advice)
def idle_states_off(_thread_id: int) -> Iterator[str]:
    """Requests a wake-up latency of 0 µs, which the kernel keeps for as long as the file is open."""
    descriptor = os.open(_DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", 0))
        yield "0 µs of wake-up latency asked of every processor"
    finally:
        os.close(descriptor)


def no_timer_slack() -> PrivilegeResult:
    """Takes the timer slack from the calling thread, for the rest of its life: its sleeps end on time, where ordinary
    threads wake up to 50 µs late to save power. It needs no privilege; a thread under SCHED_FIFO has no slack anyway.
    Raises nothing if it is denied."""
    if sys.platform != "linux":
        return PrivilegeResult(_SLACK, False, ONLY_LINUX)
    try:
        privilege.call_c("prctl", _PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0)
        slack_ns = privilege.call_c("prctl", _PR_GET_TIMERSLACK, 0, 0, 0, 0)
    except OSError as error:
        return privilege.denied(
            _SLACK, error, lambda error: f"prctl was refused ({error.strerror}): a container or sandbox forbids it"
        )
    if slack_ns > _LEAST_SLACK_NS:
        kept = f"{_LEAST_SLACK_NS} ns was asked for and {slack_ns} ns is kept: another kernel may do it"
        return PrivilegeResult(_SLACK, False, kept)
    return PrivilegeResult(_SLACK, True, f"{slack_ns} ns")
