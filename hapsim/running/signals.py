"""Signals that mean "stop" end a run in good order."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator

from hapsim.stopping import STOPS


@contextlib.contextmanager
def stopping_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """While open, SIGINT, SIGTERM and SIGHUP call `stop` (main thread only), however often they come."""

    def heard(_signal: int, _frame: object) -> None:
        stop()

    before = {number: signal.signal(number, heard) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """While open, what means "stop" is passed over: what a run has left is being written, and takes no time worth
    stopping for. Main thread only."""
    before = {number: signal.signal(number, signal.SIG_IGN) for number in STOPS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
