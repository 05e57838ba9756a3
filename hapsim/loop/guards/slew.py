"""How fast the force may change: a slew limit between two forces that are sent, and a soft start.

**The slew limit.** From one force that is sent to the next no channel changes by more than a step, in whole counts. The
step counts from what the device holds: zero after arming and once a force's time to live is over, otherwise the last
force that left.

Where the device reports a late force, or where a missing position may have reported one, the device may hold the last
force that surely arrived, or any since. The next force is within a step of all of them. That is always possible, since
each was within a step of all before it. Once the time to live of the one that surely arrived is over, the device may be
at zero, too; where no force is within a step of all these, zero leaves.

A longer row of late forces looks the same whether each comes late or none comes at all. Once it has lasted longer than
a force lives, and for LATE forces at least, only the last LATE forces count. The force then changes by a step in LATE
samples, where it would otherwise be stuck.

**The soft start.** A scene may ask for a force in the very first sample, before the hand has met anything: f0, clipped
to the limit. The force ramps up to it: of every force F

    F - f0 (1 - s(t / soft start)),     s(u) = 3 u² - 2 u³

leaves, but never less than zero and never more than F, to the side of F. Without this bound a hand that moves away from
a spring would be pulled back, and one that moves to its other side pushed beyond what is asked.

Zero force by a guard, by disarming or by the device's watchdog is immediate.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper, inlined
from hapsim.compiling.native import record_at
from hapsim.errors import UsageError
from hapsim.loop.buffers import clip
from hapsim.loop.hooks import Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import SLEWED

LATE = 4  # forces, on a wire on which every one is late, of which the device may hold one
NO_LIMIT = 1 << 40  # counts: farther than 32 bits go

_EACH, _ROW = (schema.MAX_CHANNELS,), schema.MAX_CHANNELS

SLEW = np.dtype(
    [
        ("step", np.int64, _EACH),  # counts, by which a force may differ from the one before
        ("soft_samples", np.float64),  # how long the soft start lasts; 0: none
        ("begun", np.int64),  # 1: there was a sample
        ("elapsed", np.float64),  # samples since the first
        ("first", np.float64, _EACH),  # f0, counts
        ("lives", np.int64),  # samples: the time to live of a force
        ("low", np.int64, _EACH),  # counts: the device holds no less
        ("high", np.int64, _EACH),  # and no more than that
        ("since", np.int64),  # samples since that of the force that surely came, or of the device's zero
        ("unsure", np.int64),  # forces that left since
        ("sent", np.int64, (LATE * schema.MAX_CHANNELS,)),  # counts: the forces that left last, a row each,
        ("newest", np.int64),  # and the row of the last one
        ("decided", np.int64, _EACH),  # counts, of the sample before
    ],
    align=True,
)

_slew_at = record_at(SLEW)


@hook
def shape_force(slew, tick):
    """Brings `io.force_counts` within a step of what the device holds."""
    slew, tick = _slew_at(slew), tick_at(tick)
    io, gap = io_at(tick.io), tick.gap
    has_left = slew.begun != 0 and tick.unsent == 0
    _note_what_is_held(slew, io.channels, gap, has_left, tick.late != 0 or gap > 1)
    if slew.begun == 0 or tick.expired or tick.withheld:
        hold_zero(slew, io.channels)
    slew.elapsed += gap if slew.begun else 0
    left = 0.0
    if slew.elapsed < slew.soft_samples:
        u = slew.elapsed / slew.soft_samples
        left = 1.0 - u * u * (3.0 - 2.0 * u)
    for c in range(io.channels):
        if slew.begun == 0:
            slew.first[c] = clip(io.asked[c], io.force_limit[c]) / io.force_scale[c]
        counts = io.force_counts[c]
        taken_off = np.int64(np.rint(slew.first[c] * left))
        if taken_off != 0:
            less = counts - taken_off
            counts = max(min(less, counts), 0) if counts > 0 else min(max(less, counts), 0)
        counts = _within_a_step(slew, c, counts)
        if tick.withheld == 0 and counts != io.force_counts[c]:
            io.force_counts[c] = counts
            tick.flags |= SLEWED
        slew.decided[c] = io.force_counts[c]
    slew.begun = 1
    return 0


@helper
def _note_what_is_held(slew, channels, gap, has_left, is_unsure):
    """Between which forces the device's is by now. `has_left`: the force of the sample before; `is_unsure`: it may not
    have come in time."""
    slew.since += gap
    if has_left:
        if is_unsure:
            slew.unsure += 1
        else:
            slew.since, slew.unsure = gap, 0
        slew.newest = (slew.newest + 1) % LATE
        for c in range(channels):
            sent = slew.decided[c]
            slew.sent[slew.newest * _ROW + c] = sent
            slew.low[c] = min(slew.low[c], sent) if is_unsure else sent
            slew.high[c] = max(slew.high[c], sent) if is_unsure else sent
    if slew.unsure > 0 and slew.since > slew.lives + 1:
        for c in range(channels):
            _without_what_is_over(slew, c)


@helper
def _without_what_is_over(slew, channel):
    """The force that surely came has no more time to live: the device holds a late one, or zero."""
    if slew.unsure < LATE:
        slew.low[channel], slew.high[channel] = min(slew.low[channel], 0), max(slew.high[channel], 0)
        return
    low = high = slew.sent[channel]
    for row in range(1, LATE):
        low, high = min(low, slew.sent[row * _ROW + channel]), max(high, slew.sent[row * _ROW + channel])
    slew.low[channel], slew.high[channel] = low, high


@inlined
def hold_zero(slew, channels):
    """From here on the device holds zero, or will once what is decided for now is over."""
    slew.since = slew.unsure = 0
    for c in range(channels):
        slew.low[c] = slew.high[c] = 0


@helper
def _within_a_step(slew, channel, counts):
    """The counts, or what is next to them within a step of all that the device may hold; zero where nothing is."""
    low, high, step = slew.low[channel], slew.high[channel], slew.step[channel]
    return 0 if high - low > 2 * step else max(min(counts, low + step), high - step)


def _set_up(loop: Any, setting: Setting) -> Any:
    """Raises UsageError where a step would be less than a count."""
    from hapsim.prediction.force_bounds import ONE_PERIOD, below_a_count

    slew, scene, description, bounds = loop.slew, setting.scene, setting.description, setting.bounds
    is_limited = math.isfinite(bounds.slew_limit)
    if not is_limited and bounds.soft_start_s <= 0.0:
        return None
    if is_limited and (why := below_a_count(scene, description.force_scale)):
        raise UsageError(why)
    with np.errstate(over="ignore"):
        counts = np.floor(bounds.slew_limit * scene.period / np.array(description.force_scale) * ONE_PERIOD)
    least = 1 if scene.device.slew_limit is None else 0  # a device of few counts has no finer step
    slew.step[: description.channels] = np.clip(counts, least, NO_LIMIT)
    slew.soft_samples, slew.lives = bounds.soft_start_s * scene.rate, loop.control.time_to_live
    return slew


GUARD = Guard("slew", SLEW, {Stage.SHAPE: shape_force}, _set_up)
