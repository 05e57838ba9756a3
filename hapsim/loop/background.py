"""Background tasks of a running loop, which does not wait for them."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from concurrent.futures import Future, wait
from typing import Generic, TypeVar

Result = TypeVar("Result")
_NAME = "beside the loop"
_GRACE_S, _SLICE_S = 0.5, 0.1


class BackgroundWork(Generic[Result]):
    """A function that runs in a thread of its own. The end of the program does not wait for it.

    `idle_priority`: the thread runs only where no other wants the processor (SCHED_IDLE). On a machine with few
    processors a loop that wakes up would otherwise wait milliseconds for its turn. Not for a loop in Python: the thread
    may lose the processor while it holds the interpreter's lock.
    """

    def __init__(self, work: Callable[[], Result], idle_priority: bool = True) -> None:
        self._future: Future[Result] = Future()
        threading.Thread(target=self._run, args=(work, idle_priority), name=_NAME, daemon=True).start()

    def result(self) -> Result:
        """Waits for the function; returns its result or raises its error. An interrupt ends the wait, not the task."""
        while not self._future.done():
            wait([self._future], _SLICE_S)  # in slices, because another thread may receive the interrupt
        return self._future.result()

    def _run(self, work: Callable[[], Result], idle_priority: bool) -> None:
        if idle_priority:
            with contextlib.suppress(OSError, AttributeError):  # systems without this scheduling
                os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        try:
            self._future.set_result(work())
        except BaseException as error:
            self._future.set_exception(error)


def exit_with_unfinished(status: int) -> None:
    """Ends the process with this exit status if a task still runs: the interpreter would crash at its own end."""
    left = [thread for thread in threading.enumerate() if thread.name == _NAME]
    for thread in left:
        thread.join(_GRACE_S)
    if any(thread.is_alive() for thread in left):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):  # a closed pipe
                stream.flush()
        os._exit(status)
