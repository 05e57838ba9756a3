"""A sign of life while something is compiled, and interrupts that wait until they do no harm."""

from __future__ import annotations

import contextlib
import gc
import signal
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

from hapsim.stopping import STOPS


@contextlib.contextmanager
def on_compilation(tell: Callable[[str], None]) -> Iterator[None]:
    """While open, `tell(name)` is called as the compilation of each function begins; never where the code was kept.

    An interrupt (Ctrl-C, or another signal of `STOPS` that somebody here hears) that comes during a compilation is
    raised before the next function's: in the middle of one it would leave the compiler in pieces.
    """
    from numba.core import event

    watcher = _Watcher(tell)

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            watcher.begin(str(event.data.get("name") or event.data["dispatcher"].py_func.__name__))

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            watcher.end()

    with event.install_listener("numba:compile", Listener()):
        yield


class Counted:
    """Counts functions as their compilation begins: `on_compilation(counted.add)`. `tell` hears each one's name, and
    how far all are, 0 to 1, or None where nobody has said how many to expect."""

    def __init__(self, tell: Callable[[str, float | None], None]) -> None:
        self._tell = tell
        self._expected = 0
        self.functions = 0
        """How many have begun."""
        self._adding = threading.Lock()

    def expect(self, functions: int) -> None:
        """So many more are to come."""
        self._expected += functions

    def add(self, name: str) -> None:
        """Another one begins. Any thread may say so."""
        with self._adding:
            self.functions += 1
            self._tell(name, min(self.functions / self._expected, 0.99) if self._expected else None)


def compiling(function: Any, name: str) -> contextlib.AbstractContextManager[None]:
    """While open, numba's listeners hear that `function` is compiled: numba reports nothing of a `cfunc`."""
    from numba.core import event

    return event.trigger_event("numba:compile", {"dispatcher": SimpleNamespace(py_func=function), "name": name})


class _Watcher(threading.local):
    """Tells of each function. While the first of them, and all that it calls, is compiled, interrupts wait, and so does
    Python's garbage collector: it would take a tenth of the time, and finds next to nothing. What is under way it knows
    of each thread by itself."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell = tell
        self._collected = False
        self._depth = 0

    def begin(self, name: str) -> None:
        """`name` is compiled from now on. KeyboardInterrupt where one was kept and another function is under way."""
        self._depth += 1  # first: `end` is called even where this raises
        if self._depth == 1:
            _interrupts.keep()
            self._collected = gc.isenabled()
            gc.disable()
        else:
            _interrupts.raise_kept()
        self._tell(name)

    def end(self) -> None:
        """What was begun last is compiled. KeyboardInterrupt where one was kept and nothing is under way any more."""
        self._depth = max(self._depth - 1, 0)  # another listener may have failed before this one heard of it
        if self._depth == 0:
            if self._collected:
                gc.enable()
            _interrupts.let_through()


class _KeptInterrupts:
    """Keeps interrupts for later; only the main thread ever gets any. Several may ask for it, and end in any order.
    A signal that nobody hears does what it does by default."""

    def __init__(self) -> None:
        self._before: dict[int, Any] = {}
        self._asked = 0
        self._came = False

    def keep(self) -> None:
        """From now on an interrupt is remembered instead of raised."""
        if not _in_main_thread():
            return
        if self._asked == 0:
            self._before = {number: handler for number in STOPS if callable(handler := signal.getsignal(number))}
            for number in self._before:
                signal.signal(number, self._remember)
        self._asked += 1

    def let_through(self) -> None:
        """Back to how it was, once all have said so; raises the one that came."""
        if not _in_main_thread() or self._asked == 0:
            return
        self._asked -= 1
        if self._asked == 0:
            for number, handler in self._before.items():
                signal.signal(number, handler)
            self.raise_kept()

    def raise_kept(self) -> None:
        """Raises the one that came, once."""
        if self._came and _in_main_thread():
            self._came = False
            raise KeyboardInterrupt

    def _remember(self, _signal: int, _frame: object) -> None:
        self._came = True


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


_interrupts = _KeptInterrupts()
