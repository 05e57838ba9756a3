"""Compiling hapsim's hot path: the decorators, and a sign of life while the first compilation runs."""

from __future__ import annotations

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

import firmware_protocol
from firmware_protocol.compiled import Compiler

_compiler = Compiler(Path(__file__).parent, Path(firmware_protocol.__file__).parent)
jit, inlined, jit_inlined = _compiler.jit, _compiler.inlined, _compiler.jit_inlined
fused, summed, part, overload = _compiler.fused, _compiler.summed, _compiler.part, _compiler.overload
"""For functions of hapsim, which may call any compiled function of either package (see firmware_protocol.compiled)."""


def compile_for(function: Any, *arguments: Any) -> None:
    """Compiles a function for arguments of these types, or loads it, without calling it."""
    signature = tuple(numba.typeof(argument) for argument in arguments)
    try:
        function.compile(signature)
    except (ImportError, AttributeError):
        # What was kept names the type of a port that another program brought along, and that is not here.
        function._cache.flush()
        function.compile(signature)


@contextlib.contextmanager
def on_compilation(tell: Callable[[str], None]) -> Iterator[None]:
    """While open, `tell(name)` is called as the compilation of each function begins; never where the code was kept.

    An interrupt (Ctrl-C) that comes during a compilation is raised before the next function's: in the middle of one it
    would leave the compiler in pieces.
    """
    from numba.core import event

    class Teller(event.Listener):
        def __init__(self) -> None:
            self._interrupts = _HeldInterrupts()
            self._depth = 0

        def on_start(self, event: Any) -> None:
            self._depth += 1  # first: numba calls `on_end` even where this raises
            if self._depth == 1:
                self._interrupts.hold()
            else:
                self._interrupts.raise_held()
            tell(str(event.data["dispatcher"].py_func.__name__))

        def on_end(self, event: Any) -> None:  # noqa: ARG002
            self._depth -= 1
            if self._depth == 0:
                self._interrupts.release()

    with event.install_listener("numba:compile", Teller()):
        yield


class _HeldInterrupts:
    """Keeps interrupts for later; only the main thread ever hears of any."""

    def __init__(self) -> None:
        self._before: Any = None
        self._came = False

    def hold(self) -> None:
        """From now on an interrupt is remembered instead of raised."""
        if threading.current_thread() is threading.main_thread():
            self._before = signal.signal(signal.SIGINT, self._remember)

    def release(self) -> None:
        """Back to how it was; raises the one that came."""
        if self._before is not None:
            signal.signal(signal.SIGINT, self._before)
            self._before = None
        self.raise_held()

    def raise_held(self) -> None:
        """Raises the one that came, once."""
        if self._came:
            self._came = False
            raise KeyboardInterrupt

    def _remember(self, _signal: int, _frame: object) -> None:
        self._came = True
