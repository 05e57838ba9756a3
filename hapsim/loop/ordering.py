"""A fence between two threads' memory accesses: numba has no atomic operations on processors (numba issue 2988).

What stands before a fence is seen by every other processor before what stands behind it, and the compiler moves nothing
across. On x86, where the processor keeps the order of loads and of stores anyway, it costs no instruction.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic


@intrinsic
def fence(_typing_context: Any) -> Any:
    """Call it as `fence()`."""

    def generate(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
        builder.fence("acq_rel")
        return context.get_dummy_value()

    return types.void(), generate
