"""Outside the travel that a scene declares for its device, the force fades; beyond a margin there, the loop stops.

A position x is outside by max(low - x, x - high). There the force that would leave, clipped and with any push, is
multiplied by 1 - outside / margin, and is zero beyond the margin. So a fade is no steeper than force_limit / margin,
which is judged as a stiffness before a run. A device that rests at its own stop, within the margin, feels less force.

Beyond the margin a motor has the wrong sign, or the zero is not where the scene has it. The loop stops as soon as noise
and counts do not explain the position. A device that is armed outside may stay there: until it comes within its travel,
the margin begins where it was armed.

A scene without a travel never compiles this: its address is 0 then.
"""

from __future__ import annotations

import numpy as np
from numba import types

from firmware_protocol import schema
from hapsim.compiling.native import function_at, native, record_at
from hapsim.loop.buffers import IO_BUFFER

NOISE_RMS = 8.0  # of the sensor's noise, where it is known: one sample in 1e15 has more

WITHIN, OUTSIDE, BEYOND = 0, 1, 2  # the device is within its travel, outside, where the force fades, or too far

_EACH = (schema.MAX_CHANNELS,)

TRAVEL = np.dtype(
    [
        ("address", np.uint64),  # of all this
        ("fade", np.uint64),  # and of what fades the force; 0: it leaves as it is
        ("low", np.float64, _EACH),  # m, the limits; infinite: none
        ("high", np.float64, _EACH),
        ("margin", np.float64, _EACH),  # m, the width of the band outside them
        ("unsure", np.float64, _EACH),  # m, by what noise and counts may be wrong
        ("begun", np.int64),  # 1: there was a sample
        ("armed", np.float64, _EACH),  # m, how far outside it was armed; 0 once it was within
        ("channel", np.int64),  # which one was found beyond,
        ("position", np.float64),  # and where, m
    ],
    align=True,
)

FADE = types.int64(types.uint64, types.uint64)
call_fade = function_at(FADE)
"""Calls `fade`, with its arguments."""

_travel_at, _io_at = record_at(TRAVEL), record_at(IO_BUFFER)


@native(FADE.return_type, *FADE.args)
def fade(travel, io):
    """Fades forces and excitation on every channel that is outside. Returns the worst of WITHIN, OUTSIDE, BEYOND."""
    travel, io = _travel_at(travel), _io_at(io)
    most = WITHIN
    for c in range(io.channels):
        x = io.position_counts[c] * io.position_scale[c]
        outside = max(travel.low[c] - x, x - travel.high[c])
        if not outside > 0.0:
            travel.armed[c] = 0.0
            continue
        if travel.begun == 0:
            travel.armed[c] = outside
        left = max(1.0 - outside / travel.margin[c], 0.0)
        io.force_counts[c] = np.int64(np.rint(io.force_counts[c] * left))
        io.excitation[c] *= left
        io.as_hand[c] *= left
        most = max(most, OUTSIDE)
        if outside > travel.armed[c] + travel.margin[c] + travel.unsure[c]:
            travel.channel, travel.position, most = c, x, BEYOND
    travel.begun = 1
    return most
