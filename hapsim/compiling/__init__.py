"""Compiling the hot path: decorators, functions and records behind addresses, machine code on disk, progress."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba import extending, types

import firmware_protocol
from firmware_protocol.compiled import Compiler, fma, helper, inlined, overload, reassociated

__all__ = ["COMPILED_ROOMS", "compiler", "entry", "fence", "fma", "helper", "inlined", "overload", "reassociated"]

_HAPSIM = Path(__file__).resolve().parent.parent

COMPILED_ROOMS = (
    *(_HAPSIM / room for room in ("compiling", "cordis", "loop", "device/mock", "sound", "measuring/regression.py")),
    Path(firmware_protocol.__file__).resolve().parent,
)
"""Directories and files of all compiled functions. An edit elsewhere keeps all machine code valid."""

compiler = Compiler(*COMPILED_ROOMS)
entry = compiler.entry


def fence() -> None:
    """Separates memory accesses: other processors see those before it first, and the compiler moves none across it.
    numba has no atomic operations on processors (numba issue 2988). On x86, which keeps the order of loads and of
    stores anyway, a fence costs no instruction. Python keeps the order too."""


extending.type_callable(fence)(lambda _context: lambda: types.none)


@extending.lower_builtin(fence)
def _lower_fence(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
    builder.fence("acq_rel")
    return context.get_dummy_value()
