"""The slew limit between lines (`law: board`).

Along a line the force changes as fast as the hand moves it. From line to line it changes, at any place and speed that
the hand may have when the new one begins, by no more than a step: the bounds by no more than a step each, and

    u - b v = F + k (x_n - x) - b v

by no more than a step over the hand's reach, unless the bounds are that near. A force between bounds changes by no more
than the largest of these differences. If the wanted line is farther off, the line that is sent lies between the last
one and that: of all three numbers the same share of the way. If the last one is too far from one that may act, since
the hand went farther than was expected, it lies between these. Two lines of a spring are one, so a slew limit does not
change it, however stiff.

The device may follow the line that surely arrived, or any that was sent since (`slew.py`); the new one is within a step
of each. After the time to live of the former it may be at zero.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper, inlined

LINES = 32  # that were sent last: more than the time to live at 1 kHz
_EACH, _C = (schema.MAX_CHANNELS,), schema.MAX_CHANNELS
_NUMBERS = 5  # its value at position 0 (N), k, b, low, high
_ROW = _NUMBERS * _C

LINE_SLEW = np.dtype(
    [
        ("decided", np.float64, (_ROW,)),  # the line of the sample before
        ("sent", np.float64, ((LINES + 1) * _ROW,)),  # those that were sent last, and the one that surely arrived
        ("newest", np.int64),  # row of the last one
        ("has_sure", np.int64),  # 1: the last row's may still act
        ("rate", np.float64),  # Hz
        ("until", np.float64),  # samples until a line ends,
        ("reach", np.float64, _EACH),  # m, by which the force moves the hand until then,
        ("faster", np.float64, _EACH),  # and m/s that it adds to its speed
    ],
    align=True,
)


@helper
def keep_lines(lines, channels, is_unsure):
    """Keeps the line of the last sample, which was sent. `is_unsure`: it may not have arrived."""
    lines.newest = (lines.newest + 1) % LINES
    if not is_unsure:
        lines.has_sure = 1
    for i in range(_NUMBERS):
        for c in range(channels):
            at = i * _C + c
            lines.sent[lines.newest * _ROW + at] = lines.decided[at]
            if not is_unsure:
                lines.sent[LINES * _ROW + at] = lines.decided[at]


@inlined
def let_expire(lines, is_zero):
    """Ends the life of the line that surely arrived. `is_zero`: the device may be at zero since."""
    if is_zero:
        zero_lines(lines)
    else:
        lines.has_sure = 0


@inlined
def zero_lines(lines):
    """Lets the device be at zero, surely."""
    lines.has_sure = 1
    for i in range(LINES * _ROW, (LINES + 1) * _ROW):
        lines.sent[i] = 0.0


@helper
def follow_line(lines, io, c, gap, step, late):
    """Brings the line of channel c within `step` N of all that the device may follow. Returns whether that changed it.
    `gap`: samples since the last position; `late`: lines since the one that surely arrived."""
    x, way = io.measured[c], abs(io.measured[c] - io.before[c]) / gap
    more = (lines.until + gap + 2 * late - 1) / lines.until  # an older line is compared farther ahead
    reach, speed = way * lines.until * more + more * more * lines.reach[c], way * lines.rate + more * lines.faster[c]
    wanted = io.line_force[c], io.stiffness[c], io.damping[c], io.low[c], io.high[c]
    low, high, share = io.low[c], io.high[c], 1.0
    last, count = _line_at(lines, lines.newest if late > 0 else LINES, c, x), late + lines.has_sure
    for i in range(count):
        io.low[c] = min(io.low[c], _candidate(lines, i, late, c, x)[3] + step)
        io.high[c] = min(io.high[c], _candidate(lines, i, late, c, x)[4] + step)
    for i in range(count):
        io.low[c] = max(io.low[c], _candidate(lines, i, late, c, x)[3] - step)
        io.high[c] = max(io.high[c], _candidate(lines, i, late, c, x)[4] - step)
    target, farthest = wanted, step
    for i in range(count):
        one = _candidate(lines, i, late, c, x)
        off, before = _apart(wanted, one, reach, speed), _apart(last, one, reach, speed)
        if off > step < max(io.high[c] - one[3], one[4] - io.low[c]):
            if before > farthest:  # the hand has gone farther than was expected: back to within a step
                target, farthest, share = one, before, min(1.0 - step / before, 0.5)
            elif farthest == step:
                share = min(share, (step - before) / (off - before) if off > before else 0.0)
    if share < 1.0:
        io.line_force[c] = last[0] + share * (target[0] - last[0])
        io.stiffness[c] = last[1] + share * (target[1] - last[1])
        io.damping[c] = last[2] + share * (target[2] - last[2])
    numbers = io.line_force[c] + io.stiffness[c] * x, io.stiffness[c], io.damping[c], io.low[c], io.high[c]
    for i in range(_NUMBERS):
        lines.decided[np.uint64(i * _C) + c] = numbers[i]
    return share < 1.0 or io.low[c] != low or io.high[c] != high


@inlined
def _candidate(lines, i, late, c, x):
    """Returns the i-th line that the device may follow: of the late ones, the newest first, then the sure one."""
    return _line_at(lines, (lines.newest + LINES - i) % LINES if i < late else LINES, c, x)


@inlined
def _line_at(lines, row, c, x):
    """Returns the line of a row, with its value at x m."""
    at, each, sent = np.uint64(row * _ROW) + np.uint64(c), np.uint64(_C), lines.sent
    k, bounds = sent[at + each], at + each + each + each
    return sent[at] - k * x, k, sent[at + each + each], sent[bounds], sent[bounds + each]


@inlined
def _apart(one, other, reach, speed):
    """Returns the most by which the forces of two lines differ within `reach` m and up to `speed` m/s, N."""
    return abs(one[0] - other[0]) + abs(one[1] - other[1]) * reach + abs(one[2] - other[2]) * speed
