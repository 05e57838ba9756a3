"""Work beside a running loop that the loop does not have to wait for."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def giving_way(work: Callable[[], Result]) -> Result:
    """Does `work` in a thread to which the system gives a processor only where nobody else wants it (SCHED_IDLE).

    Where there are few processors a loop that is woken up would otherwise wait for milliseconds until it is its turn.
    """
    with ThreadPoolExecutor(1, "giving way", _give_way) as thread:
        return thread.submit(work).result()


def _give_way() -> None:
    with contextlib.suppress(OSError, AttributeError):  # where there is no such scheduling
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
