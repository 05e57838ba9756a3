"""Progress of compilation, and interrupts that are deferred until they do no harm."""

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
def on_compilation(report: Callable[[str], None]) -> Iterator[None]:
    """Calls `report(name)`, while open, as the compilation of each function begins, never for kept code.

    An interrupt (Ctrl-C, or another signal of `STOPS` that has a handler) during a compilation is raised before the
    next function: in the middle of one it would leave the compiler in an invalid state.
    """
    from numba.core import event

    class Listener(event.Listener):
        def on_start(self, event: Any) -> None:
            _pause.begin()
            report(str(event.data.get("name") or event.data["dispatcher"].py_func.__name__))

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            _pause.end()

    with event.install_listener("numba:compile", Listener()):
        yield


class Counted:
    """Counts functions as their compilation begins: `on_compilation(counted.add)`. `report` receives each name, and the
    share of all functions, or None once their number reaches the expected one: the total is then unknown."""

    def __init__(self, report: Callable[[str, float | None], None]) -> None:
        self._report = report
        self._expected = 0
        self.functions = 0
        """Number of functions whose compilation has begun."""
        self._adding = threading.Lock()

    def expect(self, functions: int) -> None:
        """Adds to the expected number of functions."""
        self._expected += functions

    def add(self, name: str) -> None:
        """Counts a function, from any thread."""
        with self._adding:
            self.functions += 1
            self._report(name, self.functions / self._expected if self.functions < self._expected else None)


def compiling(function: Any, name: str) -> contextlib.AbstractContextManager[None]:
    """Reports to numba's listeners, while open, that `function` is being compiled: numba does not report a `cfunc`."""
    from numba.core import event

    return event.trigger_event("numba:compile", {"dispatcher": SimpleNamespace(py_func=function), "name": name})


class _Pause(threading.local):
    """Defers interrupts and garbage collection while a thread compiles a function and its callees. Only the main thread
    gets interrupts. The collector would take a tenth of the time and finds next to nothing."""

    def __init__(self) -> None:
        self._depth = 0
        self._collects = self._interrupted = False
        self._handlers: dict[int, Any] = {}

    def begin(self) -> None:
        """Begins a function. Raises a deferred KeyboardInterrupt if another function is being compiled."""
        self._depth += 1  # first: `end` is called even if this raises
        if self._depth > 1:
            self._raise_waiting()
            return
        self._collects = gc.isenabled()
        gc.disable()
        if threading.current_thread() is threading.main_thread():
            handlers = {number: signal.getsignal(number) for number in STOPS}
            self._handlers = {number: handler for number, handler in handlers.items() if callable(handler)}
            for number in self._handlers:
                signal.signal(number, self._remember)

    def end(self) -> None:
        """Ends a function. Raises a deferred KeyboardInterrupt after the outermost function."""
        self._depth = max(self._depth - 1, 0)  # if another listener failed, `begin` may not have been called
        if self._depth == 0:
            if self._collects:
                gc.enable()
            while self._handlers:
                signal.signal(*self._handlers.popitem())
            self._raise_waiting()

    def _raise_waiting(self) -> None:
        if self._interrupted:
            self._interrupted = False
            raise KeyboardInterrupt

    def _remember(self, _signal: int, _frame: object) -> None:
        self._interrupted = True


_pause = _Pause()
