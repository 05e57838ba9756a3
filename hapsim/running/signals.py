"""Signals that mean "stop" end a run in good order."""

from __future__ import annotations

import contextlib
import signal
from collections.abc import Callable, Iterator


@contextlib.contextmanager
def stopping_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """While open, SIGINT, SIGTERM and SIGHUP call `stop` (main thread only)."""

    def heard(_signal: int, _frame: object) -> None:
        stop()

    meant = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, heard) for number in meant}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
