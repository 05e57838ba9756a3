"""What happened, tick by tick, on its way out of the loop: a ring with one writer, the loop, and one reader.

The loop never waits for the reader: where there is no room a row is dropped and counted. In virtual time, where waiting
costs nothing, the loop returns instead so that the reader can make room (`full`), and no row is ever lost.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.compiled import inlined
from hapsim.loop.ordering import fence

HELD = 1
"""The device says: in the sample that this position ends, no force had answered the sample before in time."""
UNSENT = 2
"""A newer position was already there: this row's force was never sent."""
LIMITED = 4
"""The force was cut to its limit."""
BRIDGED = 8
"""Positions before this one never arrived; the scene was led past them along a straight line."""
OFF_GRID = 16
"""The host is the clock, and from the last position to this one passed clearly more or less than a period."""

_CURSOR = np.dtype(
    [
        ("head", np.int64),
        ("tail", np.int64),
        ("unpublished", np.int64),
        ("dropped", np.int64),
        ("waits", np.int64),
    ]
)


class Ring(NamedTuple):
    """Rows, shape (capacity,) or (capacity, channels), and the two ends. Counts, but `asked` in N: the scene's force
    before excitation, limit and rounding."""

    sample: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    flags: NDArray[np.uint8]
    position: NDArray[np.int32]
    force: NDArray[np.int32]
    asked: NDArray[np.float64]
    cursor: np.void


def new_ring(channels: int, capacity: int, waits: bool) -> Ring:
    """An empty ring. `waits`: the loop returns when it is full (virtual time) instead of dropping rows."""
    cursor = np.zeros(1, _CURSOR)[0]
    cursor["waits"] = waits
    return Ring(
        np.zeros(capacity, np.int64),
        np.zeros(capacity, np.int64),
        np.zeros(capacity, np.uint8),
        np.zeros((capacity, channels), np.int32),
        np.zeros((capacity, channels), np.int32),
        np.zeros((capacity, channels)),
        cursor,
    )


@inlined
def full(ring):
    """Whether the loop has to return for want of room; with a margin, for positions that arrive several at once."""
    cursor = ring.cursor
    return cursor.waits != 0 and cursor.head - cursor.tail > ring.sample.size // 2


@inlined
def push(ring, sample, time_ns, flags, position, force, asked):
    """Writes a row, which the reader does not see before `publish`."""
    cursor = ring.cursor
    at = cursor.head + cursor.unpublished
    if at - cursor.tail >= ring.sample.size:
        cursor.dropped += 1
        return
    i = at % ring.sample.size
    ring.sample[i] = sample
    ring.time_ns[i] = time_ns
    ring.flags[i] = flags
    for c in range(ring.position.shape[1]):
        ring.position[i, c] = position[c]
        ring.force[i, c] = force[c]
        ring.asked[i, c] = asked[c]
    cursor.unpublished += 1


@inlined
def mark_last(ring, flag):
    """Adds a flag to the row that was pushed last, while the reader cannot see it yet."""
    cursor = ring.cursor
    if cursor.unpublished > 0:
        ring.flags[(cursor.head + cursor.unpublished - 1) % ring.sample.size] |= flag


@inlined
def publish(ring):
    """Shows the pushed rows to the reader, once they are written."""
    fence()
    ring.cursor.head += ring.cursor.unpublished
    ring.cursor.unpublished = 0


class Rows(NamedTuple):
    """Rows copied out of a ring: R of them."""

    sample: NDArray[np.int64]
    time_ns: NDArray[np.int64]
    flags: NDArray[np.uint8]
    position: NDArray[np.int32]
    force: NDArray[np.int32]
    asked: NDArray[np.float64]


def drain(ring: Ring) -> Rows:
    """Copies out and frees every published row."""
    tail, head = int(ring.cursor["tail"]), int(ring.cursor["head"])
    indices = np.arange(tail, head) % ring.sample.size
    columns: tuple[Any, ...] = ring[:-1]
    rows = Rows(*(column[indices] for column in columns))
    ring.cursor["tail"] = head
    return rows
