"""Compiling hapsim's hot path: decorators, functions and records behind addresses, what is kept, what is said."""

from __future__ import annotations

from pathlib import Path

import firmware_protocol
from firmware_protocol.compiled import Compiler

_HAPSIM = Path(__file__).resolve().parent.parent

COMPILED_ROOMS = (
    *(_HAPSIM / room for room in ("compiling", "cordis", "loop", "device/mock")),
    Path(firmware_protocol.__file__).resolve().parent,
)
"""Where compiled functions stand, and nowhere else: an edit in any other place keeps all machine code."""

compiler = Compiler(*COMPILED_ROOMS)
entry, inlined, helper = compiler.entry, compiler.inlined, compiler.helper
fma, reassociated, overload = compiler.fma, compiler.reassociated, compiler.overload
"""For functions of hapsim, which may call any compiled function of either package (see firmware_protocol.compiled)."""
