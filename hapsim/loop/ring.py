"""The ring of a trace's rows, with one writer, the loop, and one reader.

The loop never waits for the reader: if the ring is full, it drops a row and counts it. In virtual time the loop returns
instead, so that the reader can make room, and no row is ever lost.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from firmware_protocol import schema
from firmware_protocol.compiled import ONE
from firmware_protocol.lines import unpack_line
from hapsim.compiling import fence, inlined
from hapsim.compiling.native import array_at

# Flags of a row.
LATE_FORCE = 1  # the device reports that in the sample before this position no force arrived in time
UNSENT = 2  # a newer position had already arrived: this row's force was never sent
LIMITED = 4  # the force was clipped to its limit
BRIDGED = 8  # positions before this one were lost; the scene was moved along a straight line instead
OFF_GRID = 16  # the host paces, and the last two positions are clearly more or less than a period apart
SLEWED = 32  # the slew limit, the soft start or a test of the motor's sign changed the force
WITHHELD = 64  # the position was older than a force may live, so zero was sent, and the force is not LIMITED
FADED = 128  # the force was lowered: outside the device's travel, or because the position stands still

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
        ("lines", np.int64),  # 1: rows have lines
        ("hand_forces", np.int64),  # 1: rows have sensed forces and commands
        ("away", np.int64),  # points at other ports: rows end with their positions,
        ("words", np.int64),  # 1: and with the digital words
        ("waits", np.int64),  # 1: the loop returns when it is half full (virtual time) instead of dropping rows
        ("newest", np.uint64),  # address of the last written row
    ],
    align=True,
)

# Words of a row; then C each of position, force, asked force, and the sensed motion. Where the device follows lines, C
# of the force that acted, and two per channel of its line; where it follows commands, C each of the sensed force and
# the command. At the end the positions of points at other ports, and the digital words, if they are on the wire.
_SAMPLE, _TIME, _FLAGS, _TICK, _ASKED, _SENT, _VALUES = range(7)
_words_at = array_at(np.int64)

ROWS = ("sample", "time_ns", "flags", "position_counts", "force_counts", "asked_force")
"""Columns of a trace, with a row per tick."""


BEFORE = ("tick_before_ns", "asked_before_ns", "sent_before_ns")
"""Columns of a run that the host paces: time in ns from the loop's wake-up, from its last request, and from the end of
that sending, to this position."""
SENSED = {part.name: f"{part.name}_counts" for part in schema.SENSED}
"""Columns of what the device senses beside its positions, by name, in their order in a row."""
HAND_FORCE, COMMAND = "hand_force", "command_counts"
"""Name in SENSED, and a column of the same runs (`mode: admittance`): the command in counts from the scene's origin."""
_MOTIONS = len(SENSED) - 1  # columns of every row in the ring


LINE = {"stiffness_counts": "<i2", "damping_counts": "<u2", "low_counts": "<i2", "high_counts": "<i2"}
ACTED = "acted_force"
LINES = {ACTED: "<f8"} | LINE
"""Columns of a run whose device follows lines (`law: board`): N, the force of the sample that ended with this position
(board_law.py), and the line that answers it."""


AWAY = "away_position"
"""Column of a run at one of several ports: m, where the points at the other ports were taken to be (away.py)."""


WORDS = ("inputs", "outputs")
"""Columns of a run with digital words: the 32 bits that came with the position, and those that went with its answer."""


def sensed_by(parts: int) -> tuple[str, ...]:
    """Returns the names of what a device with these parts on the wire sends with each position, of SENSED."""
    return tuple(part.name for part in schema.SENSED if parts & part.bit)


def row_type(
    channels: int,
    sensed: Collection[str] = (),
    by_host: bool = False,
    lines: bool = False,
    words: bool = False,
    away: int = 0,
) -> np.dtype[Any]:
    """Returns the type of a row for its reader and in files: little-endian, without gaps. `sensed`: names of SENSED.
    `by_host`: with BEFORE. `lines`: with LINES. `words`: with WORDS. `away`: how many of AWAY. Sensed forces go with
    COMMAND."""
    types: list[Any] = ["<i8", "<i8", "u1", *((kind, (channels,)) for kind in ("<i4", "<i4", "<f8"))]
    columns: list[Any] = [*zip(ROWS, types, strict=True)]
    columns += [(column, "<i4", (channels,)) for name, column in SENSED.items() if name in sensed]
    columns += [(COMMAND, "<i4", (channels,))] if HAND_FORCE in sensed else []
    columns += [(name, kind, (channels,)) for name, kind in LINES.items() if lines]
    columns += [(AWAY, "<f8", (away,))] if away else []
    columns += [(name, "<u4") for name in WORDS if words]
    return np.dtype(columns + [(name, "<i4") for name in BEFORE if by_host])


def sensed_in(rows: NDArray[Any], scale_of: Callable[[str], ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """Returns what the device sensed beside its positions, (N, C) in SI units by name. `scale_of(name)`: SI units per
    count, by channel."""
    names = rows.dtype.names or ()
    return {name: rows[column] * np.asarray(scale_of(name)) for name, column in SENSED.items() if column in names}


def commands_in(rows: NDArray[Any], position_scale: ArrayLike) -> NDArray[np.float64]:
    """Returns the commanded positions (N, C), m from the scene's origin; without entries where there are none."""
    return rows[COMMAND] * np.asarray(position_scale) if COMMAND in (rows.dtype.names or ()) else np.empty((0, 0))


def words_in(rows: NDArray[Any]) -> dict[str, Any]:
    """Returns the columns of WORDS that rows have, (N,) each by name."""
    return {name: np.ascontiguousarray(rows[name]) for name in WORDS if name in (rows.dtype.names or ())}


def lines_in(rows: NDArray[Any]) -> dict[str, NDArray[Any]]:
    """Returns the columns of LINES that rows have, (N, C) each by name."""
    return {name: rows[name] for name in LINES if name in (rows.dtype.names or ())}


class Ring:
    """The reader's side of a ring. A row is contiguous in memory: sample, time in ns, flags, positions and forces in
    counts, the bits of the scene's force in N before excitation, limit and rounding, and what is sensed, in counts."""

    def __init__(self, record: Any, of: np.dtype[Any], capacity: int, waits: bool) -> None:
        """Makes an empty ring in `record`, a RING. `of`: type of the rows that are read. `capacity`: a power of two."""
        self.record = record
        self.of = of
        """Type of the rows, from `row_type`."""
        channels = of["position_counts"].shape[0]
        self.record.lines, self.record.words, self.record.hand_forces = (
            name in (of.names or ()) for name in (ACTED, WORDS[0], COMMAND)
        )
        self.record.away = away = of[AWAY].shape[0] if AWAY in (of.names or ()) else 0
        each = 3 + _MOTIONS + 3 * int(self.record.lines) + 2 * int(self.record.hand_forces)
        self._rows = np.zeros((capacity, _VALUES + each * channels + away + 2 * int(self.record.words)), np.int64)
        self._rows.fill(0)  # so that the loop causes no page fault
        self.record.rows = self._rows.ctypes.data
        self.record.capacity, self.record.width = self._rows.shape
        self.record.channels = channels
        self.record.waits = waits

    def drain(self) -> NDArray[Any]:
        """Returns all published rows, as `row_type`, and frees their places."""
        tail, head = int(self.record.tail), int(self.record.head)
        taken = self._rows[np.arange(tail, head) & (len(self._rows) - 1)]
        self.record.tail = head
        rows = np.empty(len(taken), self.of)
        rows["sample"], rows["time_ns"], rows["flags"] = taken[:, :_TICK].T
        before, after = np.split(taken[:, _VALUES:], [(3 + _MOTIONS) * self.record.channels], axis=1)
        position, force, asked, *sensed = np.split(before, 3 + _MOTIONS, axis=1)
        rows["position_counts"], rows["force_counts"] = position, force
        rows["asked_force"] = np.ascontiguousarray(asked).view(np.float64)
        names = self.of.names or ()
        if self.record.hand_forces:
            hand_force, rows[COMMAND] = np.split(after[:, : 2 * self.record.channels], 2, axis=1)
            sensed.append(hand_force)
        for column, counts in zip(SENSED.values(), sensed, strict=False):
            if column in names:
                rows[column] = counts
        if self.record.lines:
            acted, line = np.split(after[:, : 3 * self.record.channels], [self.record.channels], axis=1)
            rows[ACTED] = np.ascontiguousarray(acted).view(np.float64)
            for name, counts in zip(LINE, unpack_line(line[:, ::2], line[:, 1::2]), strict=True):
                rows[name] = counts
        if away := int(self.record.away):
            end = taken.shape[1] - len(WORDS) * int(self.record.words)
            rows[AWAY] = np.ascontiguousarray(taken[:, end - away : end]).view(np.float64)
        for word, name in enumerate(WORDS if self.record.words else (), -len(WORDS)):
            rows[name] = taken[:, word]
        for word, name in enumerate(BEFORE if BEFORE[0] in names else (), _TICK):
            rows[name] = np.minimum(taken[:, word], np.iinfo(np.int32).max)
        return rows


@inlined
def push(ring, state, time_ns, flags, io):
    """Writes a row of `io` and the loop's `state`, invisible to the reader before `publish`."""
    at = ring.head + ring.unpublished
    if at - ring.tail >= ring.capacity:
        ring.dropped += 1
        return
    ring.newest = ring.rows + np.uint64(8 * ring.width * (at & (ring.capacity - 1)))
    row = _words_at(ring.newest, ring.width)
    row[_SAMPLE], row[_TIME], row[_FLAGS] = state.sample, time_ns, flags
    row[_TICK], row[_ASKED], row[_SENT] = time_ns - state.tick_ns, time_ns - state.asked_ns, time_ns - state.sent_ns
    channels = np.uint64(ring.channels)
    for c in range(channels):
        row[np.uint64(_VALUES) + c] = io.position_counts[c]
        row[np.uint64(_VALUES) + channels + c] = io.force_counts[c]
        row[np.uint64(_VALUES) + channels + channels + c] = np.float64(io.asked[c]).view(np.int64)
        row[np.uint64(_VALUES + 3 * ring.channels) + c] = io.velocity_counts[c]
        row[np.uint64(_VALUES + 4 * ring.channels) + c] = io.acceleration_counts[c]
    for c in range(channels if ring.lines else np.uint64(0)):
        row[np.uint64(_VALUES + 5 * ring.channels) + c] = np.float64(io.acted[c]).view(np.int64)
        line, word = channels + c + c, np.uint64(_VALUES + 6 * ring.channels) + c + c
        row[word], row[word + ONE] = io.force_counts[line], io.force_counts[line + ONE]
    for c in range(channels if ring.hand_forces else np.uint64(0)):
        row[np.uint64(_VALUES + 5 * ring.channels) + c] = io.hand_force_counts[c]
        row[np.uint64(_VALUES + 6 * ring.channels) + c] = io.command_counts[c]
    end = ring.width - (2 if ring.words else 0)
    for i in range(np.uint64(ring.away)):
        at = io.away[np.uint64(io.away_first) + i]
        row[np.uint64(end - ring.away) + i] = np.float64(at).view(np.int64)
    if ring.words:
        row[np.uint64(ring.width - 2)], row[np.uint64(ring.width - 1)] = io.inputs, io.outputs
    ring.unpublished += 1


@inlined
def mark_last(ring, flag):
    """Adds a flag to the last row, if it is not yet published."""
    if ring.unpublished > 0:
        _words_at(ring.newest, ring.width)[_FLAGS] |= flag


@inlined
def withhold_last(ring):
    """Turns the last row, if unpublished, into that of a withheld force. Returns 1 if it was LIMITED, else 0."""
    if ring.unpublished == 0:
        return 0
    row = _words_at(ring.newest, ring.width)
    limited = 1 if row[_FLAGS] & LIMITED else 0
    row[_FLAGS] = (row[_FLAGS] | WITHHELD) & ~LIMITED
    channels = np.uint64(ring.channels)
    for c in range(channels):
        row[np.uint64(_VALUES) + channels + c] = 0
    for i in range(np.uint64(2 * ring.channels if ring.lines else 0)):
        row[np.uint64(_VALUES + 6 * ring.channels) + i] = 0
    return limited


@inlined
def publish(ring):
    """Makes the pushed rows visible to the reader."""
    fence()
    ring.head += ring.unpublished
    ring.unpublished = 0
