"""A fence between two threads' memory accesses: numba has no atomic operations on processors (numba issue 2988)."""

from __future__ import annotations

from firmware_protocol.compiled import emits


@emits(lambda builder: builder.fence("acq_rel"))
def fence() -> None:
    """Other processors see what comes before it before what comes after it, and the compiler moves nothing across.

    On x86, which keeps the order of loads and of stores anyway, it costs no instruction. Python keeps it too.
    """
