"""The last bytes each way, as they were on the wire: for the report of a run that was stopped.

Nothing is copied for it. What is received and what is sent goes to the next place of a buffer in place of its
beginning, and from the beginning again once KEPT bytes are there: what is behind that place is what was there before.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.compiling import inlined

KEPT = 1 << 14
"""Bytes that are kept at least: more than a hundred of the longest frames."""

LAST_BYTES = np.dtype(
    [
        ("at", np.int64),  # where the next bytes go
        ("end", np.int64),  # where those end that were there before the beginning was written anew
    ],
    align=True,
)
"""Of a buffer that has KEPT bytes and room for the most that come at once."""


@inlined
def next_place(last):
    """Where the next bytes go; whoever puts them there moves `last.at` behind them."""
    if last.at >= KEPT:
        last.end = last.at
        last.at = 0
    return last.at


def in_order(last: Any, buffer: NDArray[np.uint8]) -> bytes:
    """What is kept, oldest first."""
    at, end = int(last.at), int(last.end)
    return buffer[at:end].tobytes() + buffer[:at].tobytes()


def put(last: Any, buffer: NDArray[np.uint8], data: bytes) -> None:
    """Keeps bytes, outside of the compiled loop."""
    at = int(next_place(last))
    buffer[at : at + len(data)] = np.frombuffer(data, np.uint8)
    last.at = at + len(data)
