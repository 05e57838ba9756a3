"""One processor for the loop's thread, which then keeps its caches, and none of the process's other threads on it.

Where SCHED_FIFO is denied another thread on the same processor makes the loop wait for its whole time slice, some
milliseconds; where it is granted, the loop makes the other one wait. So the others move, if there is anywhere to go.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from pathlib import Path

from hapsim.loop.realtime.privilege import measure

_ISOLATED = Path("/sys/devices/system/cpu/isolated")
_THREADS = Path("/proc/self/task")


def _advise(error: OSError) -> str:
    return (
        f"no single CPU could be chosen ({error.strerror}): `taskset -c 1 hapsim run …` chooses one from outside, and "
        "a control group (cpuset.cpus) or a container may forbid it"
    )


@measure("one processor", _advise)
def pinned(thread_id: int) -> tuple[str, Callable[[], object]]:
    """The thread on one CPU: one that is isolated from the scheduler, else the last that is allowed. The process's
    other threads leave it where they may run elsewhere; one that is started meanwhile runs where its starter does."""
    allowed = os.sched_getaffinity(thread_id)
    cpu, detail = _pin(thread_id, allowed)
    moved = _clear(cpu)

    def undo() -> None:
        _set_each(moved)
        _set_each({thread_id: allowed})

    if moved:
        detail += f"; {len(moved)} other thread{'s' if len(moved) > 1 else ''} moved off it"
    return detail, undo


def _pin(thread_id: int, allowed: set[int]) -> tuple[int, str]:
    """The CPU that the thread is on now, and the same in words."""
    isolated = _isolated()
    # An isolated one is as a rule not among the allowed: that is what keeps everybody else off it.
    for cpu in sorted(isolated, key=lambda cpu: (cpu in allowed, cpu), reverse=True):
        with contextlib.suppress(OSError):
            os.sched_setaffinity(thread_id, {cpu})
            return cpu, f"CPU {cpu}, isolated from the scheduler"
    # CPU 0 serves most interrupts, so the last one.
    cpu = max(allowed)
    os.sched_setaffinity(thread_id, {cpu})
    return cpu, f"CPU {cpu}" if len(allowed) > 1 else f"CPU {cpu}, the only one allowed: there was nothing to choose"


def _isolated() -> set[int]:
    """The CPUs that the kernel keeps its scheduler off, as in ``2-3,6``."""
    try:
        ranges = [part.split("-") for part in _ISOLATED.read_text(encoding="utf-8").strip().split(",") if part]
        return {cpu for ends in ranges for cpu in range(int(ends[0]), int(ends[-1]) + 1)}
    except (OSError, ValueError):  # not told, or not in numbers
        return set()


def _clear(cpu: int) -> dict[int, set[int]]:
    """Moves the threads of the process off `cpu`, but for those that may run nowhere else, as the one just pinned to
    it; which ones, and where they were allowed before."""
    moved = {}
    for thread in _threads():
        with contextlib.suppress(OSError):  # it has ended, or has nowhere else to go
            before = os.sched_getaffinity(thread)
            if cpu in before:
                os.sched_setaffinity(thread, before - {cpu})
                moved[thread] = before
    return moved


def _threads() -> list[int]:
    try:
        return [int(thread) for thread in os.listdir(_THREADS)]
    except OSError:
        return []


def _set_each(affinities: dict[int, set[int]]) -> None:
    for thread, cpus in affinities.items():
        with contextlib.suppress(OSError):  # it has ended
            os.sched_setaffinity(thread, cpus)
