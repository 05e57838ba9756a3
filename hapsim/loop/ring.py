"""What happened, tick by tick, on its way out of the loop: a ring with one writer, the loop, and one reader.

The loop never waits for the reader: where there is no room a row is dropped and counted. In virtual time, where waiting
costs nothing, the loop returns instead so that the reader can make room, and no row is ever lost.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol.compiled import compact
from hapsim.compiling import inlined
from hapsim.compiling.memory_fence import fence
from hapsim.compiling.native import array_at

LATE_FORCE = 1
"""The device says: in the sample that this position ends, no force had answered the sample before in time."""
UNSENT = 2
"""A newer position was already there: this row's force was never sent."""
LIMITED = 4
"""The force was cut to its limit."""
BRIDGED = 8
"""Positions before this one never arrived; the scene was led past them along a straight line."""
OFF_GRID = 16
"""The host is the clock, and from the last position to this one passed clearly more or less than a period."""
SLEWED = 32
"""The force was brought closer to the one before: the slew limit, or the soft start; or it was released, for a test
which way a motor pushes."""
WITHHELD = 64
"""The position was older than a force may live: zero force takes the place of what answers it, so it is not LIMITED."""
FADED = 128
"""The position is outside the device's travel: the force is less than the scene's, or zero."""

RING = np.dtype(
    [
        ("rows", np.uint64),  # address of `capacity` rows of `width` words
        ("capacity", np.int64),  # a power of two
        ("width", np.int64),
        ("channels", np.int64),
        ("head", np.int64),
        ("tail", np.int64),
        ("unpublished", np.int64),
        ("dropped", np.int64),
        ("waits", np.int64),  # 1: the loop returns when it is half full (virtual time) instead of dropping rows
        ("newest", np.uint64),  # address of the row that was written last
    ],
    align=True,
)

_SAMPLE, _TIME, _FLAGS, _VALUES = 0, 1, 2, 3  # words of a row; then C each of position, force and asked
_words_at = array_at(np.int64)


ROWS = ("sample", "time_ns", "flags", "position_counts", "force_counts", "asked_force")
"""The columns of a row for each tick, by their names in a trace."""


def row_type(channels: int) -> np.dtype[Any]:
    """A row as its reader gets it, and as it is in files: little-endian, without gaps."""
    each = (channels,)
    return np.dtype(
        [
            ("sample", "<i8"),
            ("time_ns", "<i8"),
            ("flags", "u1"),
            ("position_counts", "<i4", each),
            ("force_counts", "<i4", each),
            ("asked_force", "<f8", each),
        ]
    )


class Ring:
    """The reader's side. A row lies together in memory, which the loop touches once a tick: sample, time in ns, flags,
    the positions and the forces in counts, and the bits of the scene's force in N before excitation, limit and
    rounding."""

    def __init__(self, record: object, channels: int, capacity: int, waits: bool) -> None:
        """An empty ring in `record`, a RING; `capacity` is a power of two."""
        self.record: np.record = record  # type: ignore[assignment]
        self._rows = np.zeros((capacity, _VALUES + 3 * channels), np.int64)
        self._rows.fill(0)  # touched here: the loop meets no page that is not there yet
        self.record.rows = self._rows.ctypes.data
        self.record.capacity, self.record.width = self._rows.shape
        self.record.channels = channels
        self.record.waits = waits

    def drain(self) -> NDArray[Any]:
        """Copies out and frees every published row: an array of `row_type`."""
        tail, head = int(self.record.tail), int(self.record.head)
        taken = self._rows[np.arange(tail, head) & (len(self._rows) - 1)]
        self.record.tail = head
        rows = np.empty(len(taken), row_type(int(self.record.channels)))
        rows["sample"], rows["time_ns"], rows["flags"] = taken[:, :_VALUES].T
        rows["position_counts"], rows["force_counts"], asked = np.split(taken[:, _VALUES:], 3, axis=1)
        rows["asked_force"] = np.ascontiguousarray(asked).view(np.float64)
        return rows


@inlined
def push(ring, sample, time_ns, flags, io):
    """Writes a row, which the reader does not see before `publish`. `io`: what was exchanged."""
    compact()
    at = ring.head + ring.unpublished
    if at - ring.tail >= ring.capacity:
        ring.dropped += 1
        return
    ring.newest = ring.rows + np.uint64(8 * ring.width * (at & (ring.capacity - 1)))
    row = _words_at(ring.newest, ring.width)
    row[_SAMPLE] = sample
    row[_TIME] = time_ns
    row[_FLAGS] = flags
    channels = np.uint64(ring.channels)
    for c in range(channels):
        row[np.uint64(_VALUES) + c] = io.position_counts[c]
        row[np.uint64(_VALUES) + channels + c] = io.force_counts[c]
        row[np.uint64(_VALUES) + channels + channels + c] = np.float64(io.asked[c]).view(np.int64)
    ring.unpublished += 1


@inlined
def mark_last(ring, flag):
    """Adds a flag to the row that was pushed last, while the reader cannot see it yet."""
    if ring.unpublished > 0:
        _words_at(ring.newest, ring.width)[_FLAGS] |= flag


@inlined
def withhold_last(ring):
    """Makes the row that was pushed last, while the reader cannot see it yet, one of a force that is withheld. Returns
    1 where it was LIMITED, else 0."""
    if ring.unpublished == 0:
        return 0
    row = _words_at(ring.newest, ring.width)
    limited = 1 if row[_FLAGS] & LIMITED else 0
    row[_FLAGS] = (row[_FLAGS] | WITHHELD) & ~LIMITED
    channels = np.uint64(ring.channels)
    for c in range(channels):
        row[np.uint64(_VALUES) + channels + c] = 0
    return limited


@inlined
def publish(ring):
    """Shows the pushed rows to the reader, once they are written."""
    fence()
    ring.head += ring.unpublished
    ring.unpublished = 0
