"""Compiling the hot path: decorators, functions and records behind addresses, kept machine code, progress."""

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
"""All compiled functions are in these directories: an edit elsewhere keeps all machine code."""

compiler = Compiler(*COMPILED_ROOMS)
entry = compiler.entry


@emits(lambda builder: builder.fence("acq_rel"))
def fence() -> None:
    """Other processors see what comes before it before what comes after it, and the compiler moves nothing across.
    numba has no atomic operations on processors (numba issue 2988). On x86, which keeps the order of loads and of
    stores anyway, a fence costs no instruction. Python keeps it too."""
