"""The slew guard: a slew limit between two forces that are sent, and a soft start.

**The slew limit.** From one sent force to the next no channel changes by more than a step, in whole counts. The step
counts from the force that the device holds: zero after arming and after a force's time to live, otherwise the last
force that was sent.

If the device reports a late force, or a lost position may have reported one, the device may hold the last force that
surely arrived, or any since. The next force is within a step of all of them. That is always possible, since each was
within a step of all before it. After the time to live of the force that surely arrived, the device may hold zero as
well. If no force is within a step of all these, zero is sent.

A longer row of late forces looks the same whether each comes late or none comes at all. If it lasts longer than a force
lives, and for LATE forces at least, only the last LATE forces count. The force then changes by a step in LATE samples;
otherwise it would be stuck.

**The soft start.** A scene may request a force in the very first sample, before the hand has touched anything: f0,
clipped to the limit. The force ramps up to it: instead of every force F, the loop sends

    F - f0 (1 - s(t / soft start)),     s(u) = 3 u² - 2 u³

bounded to between zero and F. Without this bound a hand that moves away from a spring would be pulled back, and one
that moves to its other side would be pushed harder than F.

**Lines** (`law: board`) ramp as a whole, by s(t / soft start), and are limited by `line_slew.py`.

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
from hapsim.loop.buffers import clip, scale_line, share_within_limit
from hapsim.loop.guards.line_slew import LINE_SLEW, LINES, follow_line, keep_lines, let_expire, zero_lines
from hapsim.loop.hooks import Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import SLEWED

LATE = 4  # forces that the device may hold on a wire on which every one is late
NO_LIMIT = 1 << 40  # counts: farther than 32 bits go

_EACH, _ROW = (schema.MAX_CHANNELS,), schema.MAX_CHANNELS

SLEW = np.dtype(
    [
        ("step", np.int64, _EACH),  # counts, most difference of two forces
        ("soft_samples", np.float64),  # length of the soft start; 0: none
        ("begun", np.int64),  # 1: there was a sample
        ("elapsed", np.float64),  # samples since the first
        ("first", np.float64, _EACH),  # f0, counts
        ("lives", np.int64),  # samples: the time to live of a force
        ("low", np.int64, _EACH),  # counts: least force that the device may hold
        ("high", np.int64, _EACH),  # and the largest
        ("since", np.int64),  # samples since the force that surely arrived, or since the device's zero
        ("unsure", np.int64),  # forces that were sent since
        ("sent", np.int64, (LATE * schema.MAX_CHANNELS,)),  # counts: the forces that were sent last, a row each,
        ("newest", np.int64),  # and the row of the last one
        ("decided", np.int64, _EACH),  # counts, of the sample before
        ("lines", LINE_SLEW),  # `law: board`
    ],
    align=True,
)

_slew_at = record_at(SLEW)


@hook
def shape_force(slew, tick):
    """Brings `io.force_counts` within a step of the force that the device holds."""
    slew, tick = _slew_at(slew), tick_at(tick)
    io, gap = io_at(tick.io), tick.gap
    has_left = slew.begun != 0 and tick.unsent == 0
    _update_held_range(slew, io.channels, gap, has_left, tick.late != 0 or gap > 1)
    if slew.begun == 0 or tick.expired or tick.withheld:
        hold_zero(slew, io.channels)
    slew.elapsed += gap if slew.begun else 0
    left = 0.0
    if slew.elapsed < slew.soft_samples:
        u = slew.elapsed / slew.soft_samples
        left = 1.0 - u * u * (3.0 - 2.0 * u)
    if io.lines:
        _shape_lines(slew, tick, left)
        return 0
    for c in range(io.channels if slew.begun == 0 else 0):
        first = io.asked[c] * share_within_limit(io, c, False)
        slew.first[c] = clip(first, io.force_limit[c]) / io.force_scale[c]
    for c in range(io.channels):
        slew.decided[c] = io.force_counts[c] if left == 0.0 and _is_near(slew, io, c) else _shaped(slew, io, c, left)
    for c in range(io.channels):
        if tick.withheld == 0 and slew.decided[c] != io.force_counts[c]:
            io.force_counts[c] = slew.decided[c]
            tick.flags |= SLEWED
        slew.decided[c] = io.force_counts[c]
    slew.begun = 1
    return 0


@helper
def _shape_lines(slew, tick, left):
    """Ramps the lines, without `left` of them, and brings each within a step of those that the device may follow."""
    io = io_at(tick.io)
    late = min(slew.unsure, LINES if slew.since <= slew.lives + 1 else LATE)
    for c in range(np.uint64(io.channels)):
        if left > 0.0:
            scale_line(io, c, 1.0 - left)
            tick.flags |= SLEWED
        if follow_line(slew.lines, io, c, tick.gap, slew.step[c] * io.force_scale[c], late):
            tick.flags |= SLEWED
    slew.begun = 1


@inlined
def _is_near(slew, io, c):
    """Returns whether every channel of a hand is within a step of all forces that the device may hold."""
    other = np.uint64(c)
    while slew.high[other] - slew.step[other] <= io.force_counts[other] <= slew.low[other] + slew.step[other]:
        other += io.to_next[other]
        if other == np.uint64(c):
            return True
    return False


@helper
def _shaped(slew, io, c, left):
    """Returns the force of a channel, in counts. All channels of its hand have one factor for the soft start and one
    for the step, so that the force does not turn."""
    along, share, other = _softened(slew, io, c, left), 1.0, np.uint64(c)
    while True:
        low, high, step = slew.low[other], slew.high[other], slew.step[other]
        if high - low > 2 * step:
            return 0
        held = _held(slew, other)
        way = _softened(slew, io, other, left) - held
        if way * share > low + step - held:
            share = (low + step - held) / way
        elif way * share < high - step - held:
            share = (high - step - held) / way
        other += io.to_next[other]
        if other == np.uint64(c):
            held = _held(slew, c)
            return held + np.int64(np.rint(share * (along - held)))


@helper
def _softened(slew, io, c, left):
    """Returns the force of a channel, in counts, without `left` of the first force: of a hand with several channels,
    of the part of that along its force. Never beyond zero or its own size."""
    counts, first, other = io.force_counts[c], slew.first[c], np.uint64(c)
    along = square = 0.0
    while io.to_next[other] != 0:
        force, scale = io.force_counts[other] * io.force_scale[other], io.force_scale[other]
        along, square = along + force * slew.first[other] * scale, square + force * force
        other += io.to_next[other]
        if other == np.uint64(c):
            first = along / square * counts if square > 0.0 else 0.0
            break
    less = counts - np.int64(np.rint(first * left))
    return max(min(less, counts), 0) if counts > 0 else min(max(less, counts), 0)


@helper
def _held(slew, c):
    """Returns the force from which a step counts: the last one that was sent, as far as the device may hold it and it
    is within a step of all that the device may hold."""
    low, high, step = slew.low[c], slew.high[c], slew.step[c]
    sent = max(min(slew.sent[slew.newest * _ROW + np.int64(c)], high), low)
    return max(min(sent, low + step), high - step)


@helper
def _update_held_range(slew, channels, gap, has_left, is_unsure):
    """Updates the range of the force that the device may hold. `has_left`: the last sample's force was sent.
    `is_unsure`: it may not have arrived in time."""
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
        keep_lines(slew.lines, channels, is_unsure)
    if slew.unsure > 0 and slew.since > slew.lives + 1:
        let_expire(slew.lines, slew.unsure < LATE)
        for c in range(channels):
            _expire_held(slew, c)


@helper
def _expire_held(slew, channel):
    """Updates the range after the sure force's time to live: the device holds a late force, or zero."""
    if slew.unsure < LATE:
        slew.low[channel], slew.high[channel] = min(slew.low[channel], 0), max(slew.high[channel], 0)
        return
    low = high = slew.sent[channel]
    for row in range(1, LATE):
        low, high = min(low, slew.sent[row * _ROW + channel]), max(high, slew.sent[row * _ROW + channel])
    slew.low[channel], slew.high[channel] = low, high


@inlined
def hold_zero(slew, channels):
    """Sets the held force to zero: the device holds zero from the next force on."""
    slew.since = slew.unsure = 0
    for c in range(channels):
        slew.low[c] = slew.high[c] = 0
    zero_lines(slew.lines)


@inlined
def leave_zero(slew, channels):
    """Takes back the force of this sample: zero is sent."""
    hold_zero(slew, channels)
    for c in range(channels):
        slew.decided[c] = 0
    for i in range(slew.lines.decided.size):
        slew.lines.decided[i] = 0.0


def _set_up(loop: Any, setting: Setting) -> Any:
    """Fills the SLEW of a LOOP. Raises UsageError if a step would be less than a count."""
    from hapsim.prediction.force_bounds import ONE_PERIOD, slew_step_error

    slew, scene, description, bounds = loop.slew, setting.scene, setting.description, setting.bounds
    is_limited = math.isfinite(bounds.slew_limit)
    if not is_limited and bounds.soft_start_s <= 0.0:
        return None
    if is_limited and (why := slew_step_error(scene, description.force_scale)):
        raise UsageError(why)
    with np.errstate(over="ignore"):
        counts = np.floor(bounds.slew_limit * scene.period / np.array(description.force_scale) * ONE_PERIOD)
    least = 1 if scene.device.slew_limit is None else 0  # a device of few counts has no finer step
    slew.step[: description.channels] = np.clip(counts, least, NO_LIMIT)
    slew.soft_samples, slew.lives = bounds.soft_start_s * scene.rate, loop.control.time_to_live
    law, lines = loop.board_law, slew.lines
    lines.until, lines.rate, lines.reach[:] = max(law.until, 1.0), scene.rate, law.reach
    lines.faster[:] = 2.0 * law.reach * scene.rate / lines.until
    return slew


GUARD = Guard("slew", SLEW, {Stage.SHAPE: shape_force}, _set_up)
