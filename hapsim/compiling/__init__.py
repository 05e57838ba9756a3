"""Compiling the hot path: decorators, functions and records behind addresses, kept machine code, progress."""

from __future__ import annotations

from pathlib import Path

import firmware_protocol
from firmware_protocol.compiled import Compiler, fma, helper, inlined, overload, reassociated

__all__ = ["COMPILED_ROOMS", "compiler", "entry", "fma", "helper", "inlined", "overload", "reassociated"]

_HAPSIM = Path(__file__).resolve().parent.parent

COMPILED_ROOMS = (
    *(_HAPSIM / room for room in ("compiling", "cordis", "loop", "device/mock", "sound")),
    Path(firmware_protocol.__file__).resolve().parent,
)
"""All compiled functions are in these directories: an edit elsewhere keeps all machine code."""

compiler = Compiler(*COMPILED_ROOMS)
entry = compiler.entry
