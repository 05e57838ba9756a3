"""Sleeps that end when they were asked to: ordinary threads otherwise wake up to 50 µs late, to save power."""

from __future__ import annotations

import sys

from hapsim.loop.realtime import c_library
from hapsim.loop.realtime.privilege import ONLY_LINUX, PrivilegeResult, denied

_MEASURE = "timer slack"
_PR_SET_TIMERSLACK = 29
_PR_GET_TIMERSLACK = 30
_LEAST_NS = 1  # 0 would mean the default


def no_timer_slack() -> PrivilegeResult:
    """Takes the timer slack from the thread that calls this, for the rest of its life. Needs no privilege; a thread
    under SCHED_FIFO has none anyway. Raises nothing for what is denied."""
    if sys.platform != "linux":
        return PrivilegeResult(_MEASURE, False, ONLY_LINUX)
    try:
        c_library.call("prctl", _PR_SET_TIMERSLACK, _LEAST_NS, 0, 0, 0)
        slack_ns = c_library.call("prctl", _PR_GET_TIMERSLACK, 0, 0, 0, 0)
    except OSError as error:
        return denied(_MEASURE, error, _advise)
    if slack_ns > _LEAST_NS:
        return PrivilegeResult(
            _MEASURE, False, f"{_LEAST_NS} ns was asked for and {slack_ns} ns is kept: another kernel may do it"
        )
    return PrivilegeResult(_MEASURE, True, f"{slack_ns} ns")


def _advise(error: OSError) -> str:
    return f"prctl was refused ({error.strerror}): a container or sandbox forbids it"
