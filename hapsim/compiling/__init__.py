"""Compiling the hot path: decorators, functions and records behind addresses, machine code on disk, progress."""

from __future__ import annotations

from pathlib import Path

import firmware_protocol
from firmware_protocol.compiled import Compiler, emits, fma, helper, inlined, overload, reassociated

__all__ = ["COMPILED_ROOMS", "compiler", "entry", "fence", "fma", "helper", "inlined", "overload", "reassociated"]

_HAPSIM = Path(__file__).resolve().parent.parent

COMPILED_ROOMS = (
    *(_HAPSIM / room for room in ("compiling", "cordis", "loop", "device/mock", "sound")),
    Path(firmware_protocol.__file__).resolve().parent,
)
"""Directories of all compiled functions. An edit elsewhere keeps all machine code valid."""

compiler = Compiler(*COMPILED_ROOMS)
entry = compiler.entry


@emits(lambda builder: builder.fence("acq_rel"))
def fence() -> None:
    """Separates memory accesses: other processors see those before it first, and the compiler moves none across it.
    numba has no atomic operations on processors (numba issue 2988). On x86, which keeps the order of loads and of
    stores anyway, a fence costs no instruction. Python keeps the order too."""
