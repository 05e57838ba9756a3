"""The signals that mean "stop": SIGINT (Ctrl-C), SIGTERM and SIGHUP, and their handling by each part of a command.

Only the standard library is imported here: this file is loaded before everything that takes long to load.
"""

from __future__ import annotations

import contextlib
import itertools
import signal
import sys
import threading
from collections.abc import Callable, Iterator

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

STOPS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name))
"""SIGINT, SIGTERM and, where a system has it, SIGHUP or SIGBREAK (Windows: Ctrl-Break, a closed console)."""

INTERRUPTED = 130
"""The exit status of a command that one of them ended while no run was under way."""

_ARMING = {"run", "measure", "identify", "doctor", "probe", "mock", "faults"}
"""The commands that arm a device. When one is stopped before that, the user has to know that nothing was armed."""


class _Command:
    ended = ""
    armed = False
    interrupted = False
    stops = 0


def note_arming() -> None:
    """Notes that a device is armed from now on."""
    _Command.armed = True


def note_interrupt() -> None:
    """Notes a KeyboardInterrupt that a handler of a run, or deferred by the compiler, raised: a library replaces it."""
    _Command.interrupted = True


def note_work(ended: str) -> None:
    """Sets the words that follow "stopped" if a stop signal ends the work from now on."""
    _Command.ended = ended


def end_interrupted() -> int:
    """Prints that the command was stopped outside a run, with --json as a document; returns the exit status."""
    ignore_stops()
    words = " ".join(itertools.takewhile(lambda word: not word.startswith("-"), ["hapsim", *sys.argv[1:]]))
    default = "before anything was armed" if _ARMING & {*sys.argv} else f"before {words} was finished"
    sentence = f"hapsim: stopped {_Command.ended or default}"
    if _Command.armed:
        sentence = "hapsim: stopped while no run was under way; its results were not printed"
    print(sentence, file=sys.stderr)
    if "--json" in sys.argv:
        import json

        print(json.dumps({"error": sentence, "exit_status": INTERRUPTED}, indent=2))
    return INTERRUPTED


def was_interrupted() -> bool:
    """Returns whether a KeyboardInterrupt was raised and not handled; a library may have replaced the exception."""
    return _Command.interrupted


def is_urgent() -> bool:
    """Returns whether a second stop signal arrived: the run releases the force and waits for no answer."""
    return _Command.stops > 1


@contextlib.contextmanager
def stops_as_interrupts() -> Iterator[None]:
    """Makes each of these signals raise KeyboardInterrupt in the with-block."""
    _Command.ended, _Command.armed, _Command.interrupted, _Command.stops = "", False, False, 0

    def interrupt(*_: object) -> None:
        _Command.interrupted = True
        raise KeyboardInterrupt

    with _handled_by(interrupt):
        yield


@contextlib.contextmanager
def stopping_on_signals(stop: Callable[[], None]) -> Iterator[None]:
    """Makes each of these signals call `stop` in the with-block."""

    def count(*_: object) -> None:
        _Command.stops += 1
        stop()

    with _handled_by(count):
        try:
            yield
        finally:
            _Command.stops = 0


def undisturbed() -> contextlib.AbstractContextManager[None]:
    """Ignores these signals in the with-block, for output that is short and must be complete."""
    return _handled_by(signal.SIG_IGN)


def ignore_stops() -> None:
    """Ignores these signals until the command ends: it has handled one, and only prints what it has."""
    _Command.interrupted = False
    if threading.current_thread() is threading.main_thread():
        for number in STOPS:
            signal.signal(number, signal.SIG_IGN)


@contextlib.contextmanager
def _handled_by(handler: Any) -> Iterator[None]:
    """Calls `handler` for these signals in the with-block (main thread only). Signals that the parent process ignores,
    as nohup does, stay ignored."""
    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():
        before = {one: old for one in STOPS if (old := signal.getsignal(one)) not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
