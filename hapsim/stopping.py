"""The signals that mean "stop", from a command's first moment until it has something to end in good order.

Nothing but the standard library is imported here: it is there before all that takes long to load.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name))
"""SIGINT, SIGTERM and, where a system has it, SIGHUP."""

INTERRUPTED = 130
"""The exit status of a command that one of them ended before it had anything armed."""

_AGAIN_S = 0.01


class _Run:
    begun = False
    interrupted = False


def note_arming() -> None:
    """A device is armed from now on: who is stopped later was not stopped before that."""
    _Run.begun = True


def sentence() -> str:
    """What is to be said of a command that was stopped while no run was under way."""
    if _Run.begun:
        return "hapsim: stopped while no run was under way; what was found until then is not told"
    return "hapsim: stopped before anything was armed"


def document() -> str:
    """The same as `--json` has it. What else writes documents may have been interrupted while it was loaded."""
    import json

    return json.dumps({"error": sentence(), "exit_status": INTERRUPTED}, indent=2)


def was_interrupted() -> bool:
    """Whether KeyboardInterrupt was raised: a library may have made another exception of it."""
    return _Run.interrupted


@contextlib.contextmanager
def heard_from_the_start() -> Iterator[Callable[[], None]]:
    """While open, each of these signals ends the command (main thread only).

    At first at once, with the sentence: only modules are loaded, and an exception in the midst of that may end as a
    traceback. Once the function that this gives was called, by KeyboardInterrupt: what was opened is closed.
    What a parent has this process ignore (nohup) stays ignored.
    """
    _Run.begun = _Run.interrupted = False
    if threading.current_thread() is not threading.main_thread():
        yield lambda: None
        return
    before: dict[int, Any] = {number: signal.getsignal(number) for number in STOPS}
    heard = [number for number, handler in before.items() if handler not in (signal.SIG_IGN, None)]

    def hear(handler: Any) -> None:
        for number in heard:
            signal.signal(number, handler)

    hook, again = sys.unraisablehook, list[threading.Timer]()
    sys.unraisablehook = _raising_again(hook, again)
    try:
        hear(_end_at_once)
        yield lambda: hear(_interrupt)
    finally:
        sys.unraisablehook = hook
        for one in again:
            one.cancel()
        for number in heard:
            signal.signal(number, before[number])


def pass_over() -> None:
    """From now on they are passed over: what is left is a sentence."""
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            signal.signal(number, signal.SIG_IGN)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    _Run.interrupted = True
    raise KeyboardInterrupt


def _end_at_once(_signal: int, _frame: FrameType | None) -> None:
    with contextlib.suppress(OSError):
        os.write(2, f"{sentence()}\n".encode())
    if "--json" in sys.argv:
        with contextlib.suppress(OSError):
            os.write(1, f"{document()}\n".encode())
    os._exit(INTERRUPTED)


def _raising_again(hook: Callable[[Any], Any], timers: list[threading.Timer]) -> Callable[[Any], Any]:
    """Python drops what is raised in a callback, and prints a traceback of it: an interrupt comes once more instead,
    when the callback is over."""

    def raise_again(dropped: Any) -> Any:
        if not issubclass(dropped.exc_type, KeyboardInterrupt):
            return hook(dropped)
        again = threading.Timer(_AGAIN_S, os.kill, (os.getpid(), signal.SIGINT))
        again.daemon = True
        timers.append(again)
        again.start()
        return None

    return raise_again
