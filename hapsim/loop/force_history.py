"""The force that acted in each sample, for guards that compare forces with the motion.

With a delay of d samples, the force that acts from sample n-1 to n answers sample n-1-d. It is the force as sent:
clipped, rounded and with every push. If that force was not sent, or the device reports it as late, the one before acted
instead, until its time to live ended. The history also keeps the scene's part without lateness: for every sample the
force that answers it, sent or not, and over lost positions a straight line between the known forces. An excitation
counts as the hand's force, and so does the part that the limit clips because of it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import address_of, array_at, record_at
from hapsim.loop.buffers import clip, share_within_limit
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at

# First columns: the scene's part of the acting force, the whole acting force, and the scene's part without lateness.
OF_SCENE, IN_ALL, IN_TIME = 0, schema.MAX_CHANNELS, 2 * schema.MAX_CHANNELS
COLUMNS = 3 * schema.MAX_CHANNELS

FORCE_HISTORY = np.dtype(
    [
        ("forces", np.uint64),  # address of (rows, 3 MAX_CHANNELS): N, the last samples
        ("mask", np.int64),  # rows - 1, and rows is a power of two
        ("newest", np.int64),  # the row of the last sample
        ("keeps_last_force", np.int64),  # 1: the device keeps a force until the next one comes
        ("lag", np.int64),  # rows from the force between samples n-1 and n to that of n,
        ("share", np.float64),  # and the share of the one before it
        ("begun", np.int64),  # 1: there was a sample
        ("late", np.int64),  # samples in a row, up to now, whose force was late
        ("decided", np.float64, (COLUMNS,)),  # N, the answer to the last sample,
        ("sent", np.float64, (COLUMNS,)),  # and the last force that was sent before
    ],
    align=True,
)

history_at, forces_at = record_at(FORCE_HISTORY), array_at(np.float64)


@hook
def keep(history, tick):
    """Keeps the forces of the last `gap` samples, and the one that answers this sample."""
    history, tick = history_at(history), tick_at(tick)
    io, gap, withheld = io_at(tick.io), tick.gap, tick.withheld
    forces = forces_at(history.forces, (history.mask + 1) * COLUMNS)
    for c in range(io.channels):
        in_all = io.force_counts[c] * io.force_scale[c]
        alone = clip(io.asked[c] * share_within_limit(io, c, False), io.force_limit[c])
        both = clip((io.asked[c] + io.excitation[c]) * share_within_limit(io, c, True), io.force_limit[c])
        of_scene = in_all - both + alone
        keep_in_time(history, forces, c, alone if withheld else of_scene, gap)
        keep_column(history, forces, OF_SCENE + c, 0.0 if withheld else of_scene, tick)
        keep_column(history, forces, IN_ALL + c, in_all, tick)
    advance(history, tick)
    return 0


@inlined
def advance(history, tick):
    """Goes on to the sample of a TICK, once all columns are kept."""
    history.late = history.late + tick.gap if tick.late else 0
    history.newest = (history.newest + tick.gap) & history.mask if history.begun else history.newest
    history.begun = 1


@helper
def keep_in_time(history, forces, c, decided, gap):
    """Keeps the answer to a sample in column IN_TIME of channel c, with a straight line over lost positions."""
    before = forces[history.newest * COLUMNS + IN_TIME + c] if history.begun else decided
    steps = gap if history.begun else 0
    for i in range(steps + 1):
        row = (history.newest + i) & history.mask
        forces[row * COLUMNS + IN_TIME + c] = before + (decided - before) * i / max(steps, 1)


@helper
def keep_column(history, forces, c, decided, tick):
    """Keeps the forces that acted, and the new one. After lost positions a late force belongs to the last of them, so
    the force before them counts as in time."""
    if history.begun:
        gap = tick.gap
        held = history.sent[c] if history.keeps_last_force else 0.0
        acted = held if tick.unsent or (tick.late and gap == 1) else history.decided[c]
        if not tick.unsent:
            history.sent[c] = history.decided[c]
        held = history.sent[c] if history.keeps_last_force and not tick.expired else 0.0
        forces[history.newest * COLUMNS + c] = 0.0 if tick.expired else acted
        for i in range(1, gap):
            forces[((history.newest + i) & history.mask) * COLUMNS + c] = held
        forces[((history.newest + gap) & history.mask) * COLUMNS + c] = decided
    else:
        forces[history.newest * COLUMNS + c] = decided
    history.decided[c] = decided


@inlined
def acting_force(history, column, before):
    """Returns the force (N) of a column, `before` samples before the last complete sample."""
    forces = forces_at(history.forces, (history.mask + 1) * COLUMNS)
    row = history.newest - before - history.lag
    newer = forces[(row & history.mask) * COLUMNS + column]
    return (1.0 - history.share) * newer + history.share * forces[((row - 1) & history.mask) * COLUMNS + column]


def history_hook(record: Any, *, delay: float, keeps_last_force: bool) -> Hook:
    """Fills a FORCE_HISTORY, and returns the hook that keeps it; arguments as of `set_history`."""
    return Hook(Stage.KEEP, keep, record, set_history(record, delay=delay, keeps_last_force=keeps_last_force))


def set_history(record: Any, *, delay: float, keeps_last_force: bool) -> NDArray[np.float64]:
    """Fills a FORCE_HISTORY, and returns its memory. `delay`: samples from the mean instant of the position to that of
    the force, -1 or more; `keeps_last_force`: the device holds a force until the next one."""
    whole = math.floor(delay)
    rows = 2 << (whole + 3).bit_length()
    forces = np.zeros((rows, COLUMNS))
    record.forces, record.mask, record.keeps_last_force = address_of(forces), rows - 1, keeps_last_force
    record.lag, record.share = whole + 1, delay - whole
    return forces
