"""Denormals, floating-point numbers below 1e-307, count as zero while a loop runs.

A string that has rung down is full of them, and arithmetic with them takes many times as long: a scene would become
slow by falling silent. It is a mode of the processor for each thread. The loop restores it at its end, since the rest
of the program may rely on such numbers.
"""

from __future__ import annotations

import platform
from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic

ir = cgutils.ir

_FLUSH_TO_ZERO, _DENORMALS_ARE_ZERO = 1 << 15, 1 << 6  # of the control register of SSE and AVX
_HAS_REGISTER = platform.machine() in ("x86_64", "AMD64")


@intrinsic
def flush_denormals(_typing: Any) -> Any:
    """Sets the mode for the calling thread; returns the one before, to `restore`. Does nothing except on x86."""

    def _generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if not _HAS_REGISTER:
            return context.get_constant(types.uint32, 0)
        register = cgutils.alloca_once(builder, ir.IntType(32))
        _call(builder, "stmxcsr", register)
        before = builder.load(register)
        builder.store(builder.or_(before, before.type(_FLUSH_TO_ZERO | _DENORMALS_ARE_ZERO)), register)
        _call(builder, "ldmxcsr", register)
        return before

    return types.uint32(), _generate


@intrinsic
def restore(_typing: Any, mode: Any) -> Any:  # noqa: ARG001
    """Restores the mode of the calling thread."""

    def _generate(context: Any, builder: Any, _signature: Any, arguments: Any) -> Any:
        if _HAS_REGISTER:
            register = cgutils.alloca_once_value(builder, arguments[0])
            _call(builder, "ldmxcsr", register)
        return context.get_dummy_value()

    return types.void(types.uint32), _generate


def _call(builder: Any, instruction: str, register: Any) -> None:
    bytes_of_it = builder.bitcast(register, ir.IntType(8).as_pointer())
    access = ir.FunctionType(ir.VoidType(), [bytes_of_it.type])
    function = cgutils.get_or_insert_function(builder.module, access, f"llvm.x86.sse.{instruction}")
    builder.call(function, [bytes_of_it])
