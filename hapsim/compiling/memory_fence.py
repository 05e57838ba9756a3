"""A fence between two threads' memory accesses: numba has no atomic operations on processors (numba issue 2988).

What stands before a fence is seen by every other processor before what stands behind it, and the compiler moves nothing
across. On x86, where the processor keeps the order of loads and of stores anyway, it costs no instruction.
"""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import lower_builtin, type_callable


def fence() -> None:
    """Call it as `fence()`. In plain Python, where the interpreter keeps the order, it does nothing."""


@type_callable(fence)
def _typed(_context: Any) -> Any:
    return lambda: types.none


@lower_builtin(fence)
def _lower(context: Any, builder: Any, _signature: Any, _arguments: Any) -> Any:
    builder.fence("acq_rel")
    return context.get_dummy_value()
