"""Numbers too small to be normal become zero, in the thread that asks for it.

A string that has rung down is full of them, and arithmetic with them takes many times as long: a scene would become
slow by falling silent. They lie below 1e-307; no hand can tell.
"""

from __future__ import annotations

import platform
from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic

ir = cgutils.ir

_FLUSH_TO_ZERO, _DENORMALS_ARE_ZERO = 1 << 15, 1 << 6  # of the control register of SSE and AVX


@intrinsic
def flush_denormals(_typing_context: Any) -> Any:
    """Sets the processor's mode for the calling thread; does nothing where it is no x86."""

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        if platform.machine() in ("x86_64", "AMD64"):
            _set_control_register(builder, _FLUSH_TO_ZERO | _DENORMALS_ARE_ZERO)
        return context.get_dummy_value()

    return types.void(), generate


def _set_control_register(builder: Any, bits: int) -> None:
    word = ir.IntType(32)
    register = cgutils.alloca_once(builder, word)
    bytes_of_it = builder.bitcast(register, ir.IntType(8).as_pointer())
    access = ir.FunctionType(ir.VoidType(), [bytes_of_it.type])
    read, write = (
        cgutils.get_or_insert_function(builder.module, access, f"llvm.x86.sse.{name}")
        for name in ("stmxcsr", "ldmxcsr")
    )
    builder.call(read, [bytes_of_it])
    builder.store(builder.or_(builder.load(register), word(bits)), register)
    builder.call(write, [bytes_of_it])
