"""How fast the force may change: a slew limit between two forces that are sent, and a soft start.

**The slew limit.** From one force that is sent to the next no channel changes by more than a step, in whole counts, so
that rounding adds nothing. It is counted from what the device holds: zero from arming on and once a force's time to
live is over, else the last force that left, whatever was worked out meanwhile. Where the device says that a force came
too late, or where a position is missing that may have said so, the device may hold that force or one before it. So the
next force is within a step of each of the POSSIBLE forces sent last since the device was known to hold one of them.
That can always be had, since each of them was within a step of all that the device might hold before it.

Three forces lost in a row are bridged so. A longer row of late forces looks the same whether each of them comes late or
none comes at all. It is taken for the first: the force then changes by a step in POSSIBLE samples, where the second
would have it stay within a step of one place for ever.

**The soft start.** A scene may ask for a force in the very first sample, before the hand has met anything: f0, cut to
the limit. It is reached along a ramp: of every force F

    F - f0 (1 - s(t / soft start)),     s(u) = 3 u² - 2 u³

leaves, but never less than zero and never more than F, to the side of F: a hand that moves away from a spring at once
would else be pulled back by what is taken off, and one that goes to the other side be pushed beyond what is asked.
Where f0 is zero nothing changes; and where F is the stiffer the object is, the ramp does not make it softer.

The way to zero by a guard, a disarming or the device's watchdog is immediate: nothing here delays that.

Who limits nothing never compiles this: it is called by an address, which is 0 then.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numpy.typing import NDArray

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, function_at, native, record_at
from hapsim.loop.guards.force_limit import cut
from hapsim.loop.io_buffer import IO_BUFFER

POSSIBLE = 4  # forces of which the device may hold one; a power of two
NO_LIMIT = 1 << 40  # counts: farther than 32 bits go

_EACH, _ROW = (schema.MAX_CHANNELS,), schema.MAX_CHANNELS

SLEW = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("shape", np.uint64),  # and of what shapes the force; 0: it leaves as it is
        ("step", np.int64, _EACH),  # counts, by which a force may differ from the one before
        ("soft_samples", np.float64),  # how long the soft start lasts; 0: none
        ("begun", np.int64),  # 1: there was a sample
        ("elapsed", np.float64),  # samples since the first
        ("first", np.float64, _EACH),  # f0, counts
        ("sent", np.int64, (POSSIBLE * schema.MAX_CHANNELS,)),  # counts: the forces that left last, a row each,
        ("newest", np.int64),  # the row of the last one,
        ("possible", np.int64),  # and of how many of them one is what the device holds
        ("decided", np.int64, _EACH),  # counts, of the sample before
    ],
    align=True,
)

SHAPE = types.int64(*[types.uint64] * 2, *[types.int64] * 5)
call_shape = function_at(SHAPE)
"""Calls `shape_force`, with its arguments."""

_slew_at, _io_at = record_at(SLEW), record_at(IO_BUFFER)


@native(SHAPE.return_type, *SHAPE.args)
def shape_force(slew, io, gap, unsent, late, expired, withheld):
    """Brings `io.force_counts` within a step of what the device holds; whether that changed them.

    `gap`: samples since the last; `unsent`: the force of then never left; `late`: the device says that it came too
    late; `expired`: its time to live is over; `withheld`: the counts are zero because no force may be sent.
    """
    slew, io = _slew_at(slew), _io_at(io)
    has_left = slew.begun != 0 and unsent == 0
    _note_what_is_held(slew, io.channels, has_left, late != 0 or gap > 1, expired != 0 or withheld != 0)
    slew.elapsed += gap if slew.begun else 0
    left = 0.0
    if slew.elapsed < slew.soft_samples:
        u = slew.elapsed / slew.soft_samples
        left = 1.0 - u * u * (3.0 - 2.0 * u)
    changed = 0
    for c in range(io.channels):
        if slew.begun == 0:
            slew.first[c] = cut(io.asked[c], io.force_limit[c]) / io.force_scale[c]
        counts = io.force_counts[c]
        taken_off = np.int64(np.rint(slew.first[c] * left))
        if taken_off != 0:
            less = counts - taken_off
            counts = max(min(less, counts), 0) if counts > 0 else min(max(less, counts), 0)
        counts = _within_a_step(slew, c, counts)
        if withheld == 0 and counts != io.force_counts[c]:
            io.force_counts[c] = counts
            changed = 1
        slew.decided[c] = io.force_counts[c]
    slew.begun = 1
    return changed


@helper
def _note_what_is_held(slew, channels, has_left, unsure, is_zero):
    """Which forces the device may hold by now. `has_left`: the one of the sample before; `unsure`: whether that came;
    `is_zero`: whatever came, the force is zero."""
    if has_left:
        slew.possible = min(slew.possible + 1, POSSIBLE) if unsure else 1
        slew.newest = (slew.newest + 1) % POSSIBLE
        for c in range(channels):
            slew.sent[slew.newest * _ROW + c] = slew.decided[c]
    if is_zero or slew.begun == 0:
        slew.possible = 1
        for c in range(channels):
            slew.sent[slew.newest * _ROW + c] = 0


@helper
def _within_a_step(slew, channel, counts):
    """The counts, or what is next to them within a step of all that the device may hold."""
    for back in range(slew.possible):
        held = slew.sent[(slew.newest - back) % POSSIBLE * _ROW + channel]
        counts = max(min(counts, held + slew.step[channel]), held - slew.step[channel])
    return counts


def limit_slew(slew: Any, *, step_counts: NDArray[np.int64] | None, soft_samples: float, channels: int) -> None:
    """Fills a SLEW. `step_counts`, (channels,): by how much a force may change, None for no limit; `soft_samples`: how
    long the soft start lasts, 0 for none. With neither, nothing is compiled and nothing is called."""
    if step_counts is None and soft_samples <= 0.0:
        return
    slew.step[:channels] = NO_LIMIT if step_counts is None else step_counts
    slew.soft_samples = soft_samples
    slew.address, slew.shape = address_of(slew), shape_force.address()
