"""Real-time measures that `hapsim run --realtime` requests of the system, each reported as granted or denied.

Each measure makes its call and reads the error: nothing is guessed from the kernel's name or from limits. A denial
costs a sentence, never the run. To add a measure, write it here and name it in `_MEASURES`. `remove_timer_slack` is not
among them: it needs no privilege and serves every run.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import gc
import math
import os
import struct
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

from hapsim.system_files import SystemFiles, cores_in

SYSTEM = SystemFiles()
ONLY_LINUX = "only Linux has it"


@dataclass(frozen=True)
class PrivilegeResult:
    """Result of one measure."""

    privilege: str
    """Usual name of the privilege: ``SCHED_FIFO``."""
    granted: bool
    detail: str
    """Granted: the exact grant (``priority 80``). Denied: reason and remedy, without a full stop."""


Measure = Callable[[int], AbstractContextManager[PrivilegeResult]]
"""Function that requests a grant for the process and its thread with this native id, until the context ends."""

Request = Callable[[int], Iterator[str]]
"""Generator that requests a grant, yields its description, and then undoes it; or raises OSError at first."""


def measure(name: str, advise: Callable[[OSError], str], *, everywhere: bool = False) -> Callable[[Request], Measure]:
    """Decorates a request as a measure called `name`. `advise` returns the sentence about an error of the call.
    `everywhere`: not only on Linux.

    The measure raises no error of the system, neither for the request nor for its undoing.
    """

    def _make(request: Request) -> Measure:
        @contextlib.contextmanager
        def _granted(thread_id: int) -> Iterator[PrivilegeResult]:
            asked = request(thread_id)
            try:
                if sys.platform == "linux" or everywhere:
                    answer = PrivilegeResult(name, True, next(asked))
                else:
                    answer = PrivilegeResult(name, False, ONLY_LINUX)
            except OSError as error:
                answer = PrivilegeResult(name, False, advise(error))
            try:
                yield answer
            finally:
                # The body's own failure matters more than a grant that could not be undone.
                with contextlib.suppress(Exception):
                    if answer.granted:
                        next(asked, None)

        return _granted

    return _make


def call_c(name: str, *arguments: int) -> int:
    """Calls a function of the C library that Python's standard library lacks. Raises OSError with its errno if it
    returns -1."""
    function = getattr(ctypes.CDLL(None, use_errno=True), name)
    # prctl takes any number of arguments and reads each of them as an unsigned long.
    result = int(function(*map(ctypes.c_ulong, arguments)))
    if result == -1:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number), name)
    return result


def is_root() -> bool:
    """Returns whether the user is root; this affects advice, never the requests."""
    return os.geteuid() == 0


def required_privilege(capability: str, item: str, value: str) -> str:
    """Returns the ways to a capability, or to enough of the limit `item`, to follow "it takes"."""
    if is_root():
        return f"{capability} (in a container: --cap-add={capability.removeprefix('CAP_')})"
    return f"{login_limit(item, value)}, or {capability}, or root"


def login_limit(item: str, value: str) -> str:
    """Returns the line that raises this user's limit on `item`, as in limits.conf(5), to follow "it takes"."""
    import pwd

    try:
        user = pwd.getpwuid(os.getuid()).pw_name
    except KeyError:  # a container need not list its user
        user = "*"
    return f"the line '{user} - {item} {value}' in /etc/security/limits.d/hapsim.conf and a new login"


# Memory that never makes the loop wait: no garbage collection, and no page fault.
#
# A collection takes tens of milliseconds, in which no other Python runs. A page that is not in memory may wait for a
# disk. Only memory that is mapped now is locked (MCL_CURRENT, not MCL_FUTURE): the loop allocates nothing, while each
# further thread would lock its whole stack and heap, 74 MB, and beyond the limit an allocation would fail during a run.

_MCL_CURRENT = 1


@measure("garbage collector frozen", lambda error: f"the garbage collector failed ({error.strerror})", everywhere=True)
def freeze_collector(_thread_id: int) -> Iterator[str]:
    """Collects garbage once, freezes the other objects, disables collection. Reference counts still free memory."""
    was_enabled, was_frozen = gc.isenabled(), gc.get_freeze_count() > 0
    gc.collect()
    if not was_frozen:  # gc.unfreeze would also thaw what was frozen before
        gc.freeze()
    gc.disable()
    yield f"{gc.get_freeze_count()} objects set aside, no collection"
    if not was_frozen:
        gc.unfreeze()
    if was_enabled:
        gc.enable()


class _GroupLimitError(OSError):
    """More memory is mapped than the control group allows."""


def memory_limit(tree: SystemFiles = SYSTEM) -> float:
    """Returns the bytes of memory that the control groups of this process allow; infinity without a limit."""
    limits = tree.group_limits("memory", ("memory.max",), ("memory.limit_in_bytes",))
    return min((float(limit) for limit in limits if limit.isdecimal()), default=math.inf)


def _mapped_bytes() -> int:
    """Returns the bytes that locking reads in: all mapped memory that allows any access."""
    lines = (line.split(maxsplit=2) for line in SYSTEM.text("proc/self/maps").splitlines())
    ranges = [span.split("-") for span, access, *_ in lines if not access.startswith("---")]
    return sum(int(end, 16) - int(start, 16) for start, end in ranges)


def _lock_advice(error: OSError) -> str:
    import resource

    if isinstance(error, _GroupLimitError):
        return f"{error.strerror} MB, and the kernel would end the run: raise its limit (MemoryMax=, docker --memory)"
    refused = f"locking {_megabytes('VmSize')} was refused ({error.strerror})"
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if error.errno not in (errno.ENOMEM, errno.EPERM):
        return refused
    if limit == resource.RLIM_INFINITY:
        return f"{refused} though no limit is set: free some memory, or let the container call mlockall"
    takes = required_privilege("CAP_IPC_LOCK", "memlock", "unlimited")
    return f"{refused}: the limit is {limit / 1e6:.3g} MB; it takes {takes}"


@measure("memory locked", _lock_advice)
def lock_memory(_thread_id: int) -> Iterator[str]:
    """Locks and reads in the process's memory. Undoing also unlocks memory that was locked before (munlockall(2))."""
    limit, needed = memory_limit(), _mapped_bytes()
    if limit < needed:  # the kernel would kill the process
        raise _GroupLimitError(
            errno.ENOMEM, f"its control group has {limit / 1e6:.0f} MB, locking takes {needed / 1e6:.0f}"
        )
    call_c("mlockall", _MCL_CURRENT)
    yield _megabytes("VmLck")
    call_c("munlockall")


def _megabytes(field: str) -> str:
    """Returns a line of the process's status in MB of 10^6 bytes; "all memory" if it cannot be read."""
    size, _, _ = SYSTEM.fields("proc/self/status").get(field, "").partition(" ")
    return f"{int(size) * 1024 / 1e6:.0f} MB" if size else "all memory"


# Scheduling of the loop's thread: before all others, on a CPU of its own that does not idle, woken on time.
#
# Without SCHED_FIFO, another thread on the same CPU makes the loop wait for its whole time slice, some milliseconds.
# With it, the loop makes the other one wait. So the process's other threads leave the loop's CPU, if there is another.
# SCHED_FIFO is safe because the loop sleeps in the kernel and never spins.

PRIORITY = 80
"""Priority above 50, that of the kernel's interrupt threads: a blocked loop does not delay them, and a disk's do not
delay the loop. Below 99, that of the kernel's own watchdogs and migrations."""

_DEVICE = "/dev/cpu_dma_latency"
_THREADS = Path("/proc/self/task")
_SLACK, _PR_SET_TIMERSLACK = "timer slack", 29
_LEAST_SLACK_NS = 1  # 0 would mean the default


def _fifo_advice(error: OSError) -> str:
    refused = f"priority {PRIORITY} was refused ({error.strerror})"
    if not isinstance(error, PermissionError):
        return refused
    group = " and real-time runtime in the control group (cpu.rt_runtime_us)" if is_root() else ""
    return f"{refused}: it takes {required_privilege('CAP_SYS_NICE', 'rtprio', str(PRIORITY))}{group}"


@measure("SCHED_FIFO", _fifo_advice)
def use_fifo(thread_id: int) -> Iterator[str]:
    """Requests SCHED_FIFO for the thread, at PRIORITY or the highest that is granted below it; never lowers it."""
    policy, parameters = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id)
    fifo = os.SCHED_FIFO | policy & os.SCHED_RESET_ON_FORK  # removing this flag takes a privilege of its own
    priority = max(PRIORITY, parameters.sched_priority)
    while True:
        try:
            os.sched_setscheduler(thread_id, fifo, os.sched_param(priority))
            break
        except PermissionError:
            if priority == 1:
                raise
            priority -= 1
    more = f", the highest that was granted: {PRIORITY} takes {login_limit('rtprio', str(PRIORITY))}"
    yield f"priority {priority}{more if priority < PRIORITY else ''}"
    os.sched_setscheduler(thread_id, policy, parameters)


def _pin_advice(error: OSError) -> str:
    return (
        f"no single CPU could be chosen ({error.strerror}): `taskset -c 1 hapsim run …` chooses one from outside, and "
        "a control group (cpuset.cpus) or a container may forbid it"
    )


@measure("one processor", _pin_advice)
def pin_to_cpu(thread_id: int) -> Iterator[str]:
    """Pins the thread to one CPU: one that is isolated from the scheduler, or else the last allowed one. The process's
    other threads leave it if they may run elsewhere."""
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
    """Pins the thread. Returns its CPU, and a phrase about it."""
    # An isolated CPU is usually not among the allowed ones: that keeps all other threads off it.
    isolated = cores_in(SYSTEM.text("sys/devices/system/cpu/isolated"))
    for cpu in sorted(isolated, key=lambda cpu: (cpu in allowed, cpu), reverse=True):
        with contextlib.suppress(OSError):
            os.sched_setaffinity(thread_id, {cpu})
            return cpu, f"CPU {cpu}, isolated from the scheduler"
    cpu = max(allowed)  # CPU 0 serves most interrupts
    os.sched_setaffinity(thread_id, {cpu})
    return cpu, f"CPU {cpu}" if len(allowed) > 1 else f"CPU {cpu}, the only one allowed: there was nothing to choose"


def _clear(cpu: int) -> dict[int, set[int]]:
    """Moves the process's threads off `cpu`, if they may run elsewhere. Returns the CPUs that each could use before."""
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
    if is_root():
        return f"{_DEVICE} was refused to root ({error.strerror}): a container needs --device={_DEVICE}"
    return (
        f"{_DEVICE} may not be written ({error.strerror}): it takes a udev rule that gives it to a group of yours "
        '(KERNEL=="cpu_dma_latency", GROUP="…", MODE="0660" in /etc/udev/rules.d/hapsim.rules), or root'
    )


@measure("power saving off", _idle_advice)
def disable_idle_states(_thread_id: int) -> Iterator[str]:
    """Requests a wake-up latency of 0 µs, which the kernel keeps while the file is open."""
    descriptor = os.open(_DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", 0))
        yield "0 µs of wake-up latency requested on all CPUs"
    finally:
        os.close(descriptor)


def remove_timer_slack() -> PrivilegeResult:
    """Removes the timer slack of the calling thread for good: it wakes up on time, while ordinary threads wake up to
    50 µs late to save power. It needs no privilege; a thread under SCHED_FIFO has no slack anyway. Raises nothing if it
    is denied."""
    if sys.platform != "linux":
        return PrivilegeResult(_SLACK, False, ONLY_LINUX)
    try:
        call_c("prctl", _PR_SET_TIMERSLACK, _LEAST_SLACK_NS, 0, 0, 0)
    except OSError as error:
        why = f"prctl was refused ({error.strerror}): a container or sandbox forbids it"
        return PrivilegeResult(_SLACK, False, why)
    return PrivilegeResult(_SLACK, True, f"{_LEAST_SLACK_NS} ns")


# Garbage is collected before memory is locked; the thread gets its priority last.
_MEASURES: tuple[Measure, ...] = (freeze_collector, lock_memory, disable_idle_states, pin_to_cpu, use_fifo)

_IN_USE = threading.Lock()  # two loops that undid their measures in the wrong order would restore neither


@contextlib.contextmanager
def realtime(thread_id: int) -> Iterator[list[PrivilegeResult]]:
    """Requests every measure for this process and its thread with the native id `thread_id` (the loop's), while open.
    Yields a PrivilegeResult for each measure.

    Enter it when everything is allocated and compiled: it takes some tenths of a second, in which memory is read in. On
    leaving, the measures are undone in reverse order, whatever the body raised. A denial raises nothing. The second of
    two loops in one process is denied all measures.
    """
    if not _IN_USE.acquire(blocking=False):
        why = "another loop of this process holds the privileges until it ends"
        yield [PrivilegeResult("real time", False, why)]
        return
    try:
        with contextlib.ExitStack() as held:
            yield [held.enter_context(measure(thread_id)) for measure in _MEASURES]
    finally:
        _IN_USE.release()
