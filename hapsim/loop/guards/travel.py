"""The travel guard: outside the declared travel the force fades, and beyond a margin there the loop stops.

A position x is outside by max(low - x, x - high). There the force, clipped and with any push, is multiplied by
1 - outside / margin, and is zero beyond the margin. So the fade is no steeper than force_limit / margin, which is
judged as a stiffness before a run. A device that rests at its own stop, within the margin, feels less force.

Beyond the margin a motor has the wrong sign, or the device's zero is wrong. The loop stops as soon as noise and counts
do not explain the position. A device that is armed outside may stay there: until it comes within its travel, the margin
begins at its position at arming.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling.native import record_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import FADED

OUT_OF_TRAVEL = -24

NOISE_RMS = 8.0  # of the sensor's noise, if known: one sample in 1e15 has more

_EACH = (schema.MAX_CHANNELS,)

TRAVEL = np.dtype(
    [
        ("low", np.float64, _EACH),  # m, the limits; infinite: none
        ("high", np.float64, _EACH),
        ("margin", np.float64, _EACH),  # m, the width of the band outside them
        ("unsure", np.float64, _EACH),  # m, error by noise and counts
        ("begun", np.int64),  # 1: there was a sample
        ("armed", np.float64, _EACH),  # m, distance outside at arming; 0 after it was within
        ("channel", np.int64),  # the channel beyond the margin,
        ("position", np.float64),  # and its position, m
        ("faded_ticks", np.int64),
    ],
    align=True,
)

_travel_at = record_at(TRAVEL)


@hook
def fade(travel, tick):
    """Fades force and excitation on every channel that is outside. Returns OUT_OF_TRAVEL beyond the margin, else 0."""
    travel, tick = _travel_at(travel), tick_at(tick)
    io = io_at(tick.io)
    is_outside, code = False, 0
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
        is_outside = True
        if outside > travel.armed[c] + travel.margin[c] + travel.unsure[c]:
            travel.channel, travel.position, code = c, x, OUT_OF_TRAVEL
    travel.begun = 1
    if is_outside:
        travel.faded_ticks += 1
        tick.flags |= FADED
    return code


def _set_up(loop: Any, setting: Setting) -> Any:
    travel, scene, used = loop.travel, setting.scene, slice(setting.scene.channels)
    if scene.device.travel is None:
        return None
    travel.low[:], travel.high[:] = -np.inf, np.inf
    travel.low[used], travel.high[used] = np.transpose(scene.device.travels(scene.channels))
    travel.margin[used] = scene.device.travel_margins(scene.channels)
    count_m = np.array(setting.description.position_scale[used])
    travel.unsure[used] = NOISE_RMS * scene.mock_device.noise + count_m
    return travel


def _sentence(run: EndedRun) -> str:
    travel, c = run.loop.travel, int(run.loop.travel.channel)
    units = run.scene.units_of(c)
    return (
        f"channel {c} is out of its travel at tick {run.report.ticks}: at "
        f"{units(travel.position, 'm', '.6g')}, where device.travel goes from {units.number(travel.low[c], 'm', 'g')} "
        f"to {units(travel.high[c], 'm', 'g')} and the force fades within {units(travel.margin[c], 'm', 'g')} outside; "
        "its force was not sent. Something drives the device outward, or its zero is not where the scene has it: a "
        "motor or an encoder with the wrong sign, a wrong device.origin, a device that restarted elsewhere, or limits "
        "that are not the device's. Move it back within its travel before the next run"
    )


GUARD = Guard("travel", TRAVEL, {Stage.LOWER: fade}, _set_up, OUT_OF_TRAVEL, "out of travel", _sentence)
