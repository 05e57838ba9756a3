"""The loop's thread before all others: SCHED_FIFO. Safe, because the loop sleeps in the kernel and never spins."""

from __future__ import annotations

import os
from collections.abc import Callable

from hapsim.loop.realtime.login_limits import is_root, login_limit
from hapsim.loop.realtime.privilege import measure

PRIORITY = 80
"""Above 50, where the kernel's interrupt threads stand: a loop that blocks holds none of them up, and is not held up by
those of a disk. Below 99, where the kernel's own watchdogs and migrations stand."""


def _advise(error: OSError) -> str:
    if not isinstance(error, PermissionError):
        return f"priority {PRIORITY} was refused ({error.strerror})"
    if is_root():
        return (
            f"priority {PRIORITY} was refused to root ({error.strerror}): it takes CAP_SYS_NICE (in a container: "
            "--cap-add=SYS_NICE) and real-time runtime in the control group (cpu.rt_runtime_us)"
        )
    return f"priority {PRIORITY} was refused ({error.strerror}): it takes {_login_limit()}, or CAP_SYS_NICE, or root"


def _login_limit() -> str:
    return login_limit("rtprio", str(PRIORITY))


@measure("SCHED_FIFO", _advise)
def fifo(thread_id: int) -> tuple[str, Callable[[], object]]:
    """SCHED_FIFO for the thread, at PRIORITY or at the highest that is granted below it; never lower than it was."""
    policy, parameters = os.sched_getscheduler(thread_id), os.sched_getparam(thread_id)
    # Whoever may not drop this flag is refused everything that comes without it.
    flag = policy & os.SCHED_RESET_ON_FORK
    priority = _highest(thread_id, os.SCHED_FIFO | flag, max(PRIORITY, parameters.sched_priority))
    detail = f"priority {priority}"
    if priority < PRIORITY:
        detail += f", the highest that was granted: {PRIORITY} takes {_login_limit()}"
    return detail, lambda: os.sched_setscheduler(thread_id, policy, parameters)


def _highest(thread_id: int, policy: int, most: int) -> int:
    """Sets the highest priority up to `most` that is granted, and returns it."""
    for priority in range(most, 1, -1):
        try:
            os.sched_setscheduler(thread_id, policy, os.sched_param(priority))
        except PermissionError:
            continue
        return priority
    os.sched_setscheduler(thread_id, policy, os.sched_param(1))
    return 1
