"""What happened, tick by tick, on its way out of the loop: a ring with one writer, the loop, and one reader.

The loop never waits for the reader: where there is no room a row is dropped and counted. In virtual time, where waiting
costs nothing, the loop returns instead so that the reader can make room (`full`), and no row is ever lost.
"""

from __future__ import annotations

from typing import NamedTuple

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


_SAMPLE, _TIME, _FLAGS, _VALUES = 0, 1, 2, 3  # columns; then C each of position, force and asked


class Ring(NamedTuple):
    """Rows of one tick each, shape (capacity, 3 + 3 C), and the two ends. A row lies together in memory, which the loop
    touches once a tick: sample, time in ns, flags, the positions and the forces in counts, and the bits of the scene's
    force in N before excitation, limit and rounding."""

    rows: NDArray[np.int64]
    cursor: np.void


def new_ring(channels: int, capacity: int, waits: bool) -> Ring:
    """An empty ring; `capacity` is a power of two. `waits`: the loop returns when it is full (virtual time) instead of
    dropping rows."""
    cursor = np.zeros(1, _CURSOR)[0]
    cursor["waits"] = waits
    rows = np.zeros((capacity, _VALUES + 3 * channels), np.int64)
    rows.fill(0)  # touched here: the loop meets no page that is not there yet
    return Ring(rows, cursor)


@inlined
def full(ring):
    """Whether the loop has to return for want of room; with a margin, for positions that arrive several at once."""
    cursor = ring.cursor
    return cursor["waits"] != 0 and cursor["head"] - cursor["tail"] > ring.rows.shape[0] // 2


@inlined
def push(ring, sample, time_ns, flags, position, force, asked):
    """Writes a row, which the reader does not see before `publish`."""
    cursor = ring.cursor
    at = cursor.head + cursor.unpublished
    if at - cursor.tail >= ring.rows.shape[0]:
        cursor.dropped += 1
        return
    row = ring.rows[np.uint64(at & (ring.rows.shape[0] - 1))]
    row[_SAMPLE] = sample
    row[_TIME] = time_ns
    row[_FLAGS] = flags
    channels = (row.size - _VALUES) // 3
    for c in range(channels):
        row[_VALUES + c] = position[c]
        row[_VALUES + channels + c] = force[c]
        row[_VALUES + 2 * channels + c] = np.float64(asked[c]).view(np.int64)
    cursor.unpublished += 1


@inlined
def mark_last(ring, flag):
    """Adds a flag to the row that was pushed last, while the reader cannot see it yet."""
    cursor = ring.cursor
    if cursor.unpublished > 0:
        ring.rows[(cursor.head + cursor.unpublished - 1) & (ring.rows.shape[0] - 1), _FLAGS] |= flag


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
    taken = ring.rows[np.arange(tail, head) & (ring.rows.shape[0] - 1)]
    ring.cursor["tail"] = head
    position, force, asked = np.split(taken[:, _VALUES:], 3, axis=1)
    return Rows(
        sample=taken[:, _SAMPLE].copy(),
        time_ns=taken[:, _TIME].copy(),
        flags=taken[:, _FLAGS].astype(np.uint8),
        position=position.astype(np.int32),
        force=force.astype(np.int32),
        asked=np.ascontiguousarray(asked).view(np.float64),
    )
