"""Work beside a running loop that the loop does not have to wait for."""

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


class Beside(Generic[Result]):
    """Work in a thread of its own, which a program that ends does not wait for.

    `gives_way`: the system gives it a processor only where nobody else wants it (SCHED_IDLE). Where there are few
    processors a loop that wakes up would otherwise wait for milliseconds until it is its turn. Not beside a loop in
    Python: a thread that gives way may keep the interpreter's lock meanwhile.
    """

    def __init__(self, work: Callable[[], Result], gives_way: bool = True) -> None:
        self._work, self._gives_way = work, gives_way
        self._results: list[Result] = []
        self._failure: BaseException | None = None
        self._over = threading.Event()  # not the thread's own end, which an interrupt while it is waited for confuses
        threading.Thread(target=self._run, name=_NAME, daemon=True).start()

    @property
    def is_done(self) -> bool:
        """Whether it is."""
        return self._over.is_set()

    def result(self) -> Result:
        """Waits for what it gives, or raises what it raised. An interrupt ends the waiting, not the work."""
        while not self._over.wait(_SLICE_S):  # in slices: an interrupt may come to another thread than this one
            pass
        if self._failure is not None:
            raise self._failure
        return self._results[0]

    def _run(self) -> None:
        if self._gives_way:
            _give_way()
        try:
            self._results.append(self._work())
        except BaseException as error:  # whoever asks for the result gets it
            self._failure = error
        finally:
            self._over.set()


def leave_unfinished(status: int) -> None:
    """Ends the process with this exit status where work is not done: an interpreter that is taken down around it
    trips over it."""
    left = [thread for thread in threading.enumerate() if thread.name == _NAME]
    for thread in left:
        thread.join(_GRACE_S)
    if any(thread.is_alive() for thread in left):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):  # nobody reads it any more
                stream.flush()
        os._exit(status)


def _give_way() -> None:
    with contextlib.suppress(OSError, AttributeError):  # where there is no such scheduling
        os.sched_setscheduler(0, os.SCHED_IDLE, os.sched_param(0))
