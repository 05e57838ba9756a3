"""Compiling hapsim's hot path: the decorators, and a sign of life while the first compilation runs."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numba

import firmware_protocol
from firmware_protocol.compiled import Compiler

_compiler = Compiler(Path(__file__).parent, Path(firmware_protocol.__file__).parent)
jit, inlined, jit_inlined = _compiler.jit, _compiler.inlined, _compiler.jit_inlined
part, overload = _compiler.part, _compiler.overload
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
    """While open, `tell(name)` is called as the compilation of each function begins; never where the code was kept."""
    from numba.core import event

    class Teller(event.Listener):
        def on_start(self, event: Any) -> None:
            tell(str(event.data["dispatcher"].py_func.__name__))

        def on_end(self, event: Any) -> None:
            pass

    with event.install_listener("numba:compile", Teller()):
        yield
