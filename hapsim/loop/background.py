"""Work beside a running loop that the loop does not wait for."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

Result = TypeVar("Result")
_NAME = "beside the loop"
_GRACE_S, _SLICE_S = 0.5, 0.1


class BackgroundWork(Generic[Result]):
    """Work in a thread of its own. The end of the program does not wait for it.

    `gives_way`: the thread gets a processor only where no other wants it (SCHED_IDLE). On a machine with few processors
    a loop that wakes up would otherwise wait milliseconds for its turn. Not beside a loop in Python: a thread that
    gives way may hold the interpreter's lock meanwhile.
    """

    def __init__(self, work: Callable[[], Result], gives_way: bool = True) -> None:
        self._work, self._gives_way = work, gives_way
        self._failure: BaseException | None = None
        self._result: Result
        self._over = threading.Event()  # not the thread's own end: an interrupt during a join confuses that
        threading.Thread(target=self._run, name=_NAME, daemon=True).start()

    @property
    def is_done(self) -> bool:
        """Whether the work has ended."""
        return self._over.is_set()

    def result(self) -> Result:
        """Waits for the work, and returns or raises what it did. An interrupt ends the wait, not the work."""
        while not self._over.wait(_SLICE_S):  # in slices: an interrupt may arrive in another thread
            pass
        if self._failure is not None:
            raise self._failure
        return self._result

    def _run(self) -> None:
        if self._gives_way:
            with contextlib.suppress(OSError, AttributeError):  # where there is no such scheduling
                os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
        try:
            self._result = self._work()
        except BaseException as error:
            self._failure = error
        finally:
            self._over.set()


def exit_with_unfinished(status: int) -> None:
    """Ends the process with this exit status if work is not done: the interpreter would crash over it as it ends."""
    left = [thread for thread in threading.enumerate() if thread.name == _NAME]
    for thread in left:
        thread.join(_GRACE_S)
    if any(thread.is_alive() for thread in left):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):  # a closed pipe
                stream.flush()
        os._exit(status)
