"""The travel guard: outside the declared travel the force fades, and beyond a margin there the loop stops.

A position x is outside by max(low - x, x - high); that of a hand with x and y by its distance from the nearest edge of
a polygon, less a radius: a disc is a polygon of one corner. There the force, clipped and with any push, is multiplied
by 1 - outside / margin, and is zero beyond the margin. So the fade is no steeper than the largest force / margin, which
is judged as a stiffness before a run. A device that rests at its own stop, within the margin, feels less force.

Beyond the margin a motor has the wrong sign, or the device's zero is wrong. The loop stops as soon as noise and counts
do not explain the position. A device that is armed outside may stay there: until it comes within its travel, the margin
begins at its position at arming.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import record_at
from hapsim.loop.buffers import scale_force
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import FADED
from hapsim.scene.schemas import MOST_CORNERS
from hapsim.scene.values import Area

OUT_OF_TRAVEL = -24

NOISE_RMS = 8.0  # of the sensor's noise, if known: one sample in 1e15 has more

_AHEAD, _TOWARDS = 1e-3, 0.1  # a step of this share of the margin leads out if its distance grows by this share of it

_EACH = (schema.MAX_CHANNELS,)

TRAVEL = np.dtype(
    [
        ("low", np.float64, _EACH),  # m, the limits; infinite: none
        ("high", np.float64, _EACH),
        ("margin", np.float64, _EACH),  # m, the width of the band outside them
        ("unsure", np.float64, _EACH),  # m, error by noise and counts
        ("begun", np.int64),  # 1: there was a sample
        ("radius", np.float64),  # m, of an area in the plane,
        ("corners", np.int64),  # its corners; 0: the limits hold,
        ("corner", np.float64, (2 * MOST_CORNERS,)),  # m, their x and y
        ("x", np.int64, _EACH),  # channels of x
        ("y", np.int64, _EACH),  # and y of the hand of each channel; both itself, if that has one
        ("armed", np.float64, _EACH),  # m, distance outside at arming; 0 after it was within
        ("channel", np.int64),  # the channel beyond the margin,
        ("outside", np.float64),  # and its distance outside, m
        ("faded_ticks", np.int64),
    ],
    align=True,
)

travel_at = record_at(TRAVEL)


@hook
def fade(travel, tick):
    """Fades force and excitation on every channel that is outside. Returns OUT_OF_TRAVEL beyond the margin, else 0."""
    travel, tick = travel_at(travel), tick_at(tick)
    io = io_at(tick.io)
    is_outside, code = False, 0
    for c in range(io.channels):
        outside = _outside(travel, io, c, 0.0)
        if not outside > 0.0:
            travel.armed[c] = 0.0
            continue
        if travel.begun == 0:
            travel.armed[c] = outside
        left = max(1.0 - outside / travel.margin[c], 0.0)
        scale_force(io, c, left)
        is_outside = True
        if outside > travel.armed[c] + travel.margin[c] + travel.unsure[c]:
            travel.channel, travel.outside, code = c, outside, OUT_OF_TRAVEL
    travel.begun = 1
    if is_outside:
        travel.faded_ticks += 1
        tick.flags |= FADED
    return code


@helper
def _outside(travel, io, c, ahead):
    """Returns how far outside (m) the hand of a channel would be `ahead` (m) along that channel; negative: within."""
    x, y = travel.x[c], travel.y[c]
    px = io.position_counts[x] * io.position_scale[x] + (ahead if x == c else 0.0)
    dx = max(travel.low[x] - px, px - travel.high[x])
    if x == y:
        return dx
    py = io.position_counts[y] * io.position_scale[y] + (ahead if y == c else 0.0)
    if travel.corners == 0:
        dy = max(travel.low[y] - py, py - travel.high[y])
        return math.hypot(max(dx, 0.0), max(dy, 0.0)) if max(dx, dy) > 0.0 else max(dx, dy)
    end = 2 * travel.corners
    ax, ay = travel.corner[end - 2], travel.corner[end - 1]
    square, is_within = math.inf, False
    for i in range(0, end, 2):
        bx, by = travel.corner[i], travel.corner[i + 1]
        ex, ey, dx, dy = bx - ax, by - ay, px - ax, py - ay
        length = ex * ex + ey * ey
        share = min(max((dx * ex + dy * ey) / length, 0.0), 1.0) if length > 0.0 else 0.0
        square = min(square, (dx - share * ex) ** 2 + (dy - share * ey) ** 2)
        if (ay > py) != (by > py) and dx < dy / ey * ex:
            is_within = not is_within
        ax, ay = bx, by
    return (-math.sqrt(square) if is_within else math.sqrt(square)) - travel.radius


@helper
def leads_out(travel, io, c, force):
    """Returns whether a hand in the plane is within the margin of an edge of the travel, and the force of its channel
    `c` presses towards that edge."""
    outside, ahead = _outside(travel, io, c, 0.0), math.copysign(_AHEAD * travel.margin[c], force)
    farther = _outside(travel, io, c, ahead) - outside
    return outside >= -travel.margin[c] and farther > _TOWARDS * abs(ahead)


def _set_up(loop: Any, setting: Setting) -> Any:
    travel, scene, used = loop.travel, setting.scene, slice(setting.scene.channels)
    area = scene.device.travel
    if area is None:
        return None
    travel.low[:], travel.high[:] = -np.inf, np.inf
    travel.low[used], travel.high[used] = np.transpose(scene.device.travels(scene.channels))
    travel.margin[used] = scene.travel_margins
    count_m = np.array(setting.description.position_scale[used])
    travel.unsure[used] = NOISE_RMS * scene.mock_device.noise + count_m
    travel.x[:] = travel.y[:] = np.arange(schema.MAX_CHANNELS)
    for hand in scene.channel_groups:
        travel.x[[*hand]], travel.y[[*hand]] = hand[0], hand[-1]
    if isinstance(area, Area):
        travel.corners, travel.radius = len(area.corners), area.radius
        travel.corner[: 2 * len(area.corners)] = np.ravel(area.corners)
    return travel


def _sentence(run: EndedRun) -> str:
    from hapsim.scene.outlines import travel_in_words

    travel, c, io = run.loop.travel, int(run.loop.travel.channel), run.loop.io
    units, hand = run.scene.units_of(c), run.scene.hand_of(c)
    which = f"channel {c} is" if len(hand) == 1 else f"channels {' and '.join(map(str, hand))} are"
    place = ", ".join(units.number(io.position_counts[one] * io.position_scale[one], "m", ".6g") for one in hand)
    place = place if len(hand) == 1 else f"({place})"
    return (
        f"{which} out of {'its' if len(hand) == 1 else 'their'} travel at tick {run.report.ticks}: at "
        f"{units(place, 'm')}, {units(travel.outside, 'm', '.4g')} outside, where device.travel goes "
        f"{travel_in_words(run.scene, c)} and the force fades within {units(travel.margin[c], 'm', 'g')} outside; "
        "its force was not sent. Something drives the device outward, or its zero is not where the scene has it: a "
        "motor or an encoder with the wrong sign, a wrong device.origin, a device that restarted elsewhere, or limits "
        "that are not the device's. Move it back within its travel before the next run"
    )


GUARD = Guard(
    "travel",
    TRAVEL,
    {Stage.LOWER: fade},
    _set_up,
    OUT_OF_TRAVEL,
    "out of travel",
    _sentence,
    stopped_motor=lambda loop: int(loop.travel.channel),
)
