"""The guard against a dead position sensor: it removes the force if the position stands still while force acts.

A hand can hold the handle still, and a dead sensor reads the same. Only a change of the force tells them apart: a live
sensor then moves by a count. For each channel the guard integrates the path w of the free handle, of the least declared
mass, under the forces that acted since the last count, from the velocity of that count on:

    v += F/m T,   w += v T.

A test begins if w exceeds a `jerk` (hapsim/scales.py) and COUNTS counts, and the position has stood still STILL_FACTOR
times as long as a live sensor did at this place. It begins in any case if w exceeds a `runaway` too, or after
MOST_WAIT_S, so that a free handle moves little farther. This limit of w grows by TRUST with every answer at this place,
up to MOST_TRUST.

A test ramps the channel's force down to zero, within RAMP_SHARE of the time of standing still, between LEAST_RAMP_S and
MOST_RAMP_S: gentle enough for a hand that holds so still. If a count changes, a hand holds the handle, and the force
returns as fast as it fell. If none changes, the force stays at zero until one does, and then returns over the soft
start.

Standing still proves nothing if declared dry friction can hold handle and hand, or if the force presses against an end
of the declared travel. Then nothing is integrated.

**A staircase.** A sensor that is refreshed too rarely stands still and then jumps. A jump after STAIR_SAMPLES or more
is a stair if it is at least COUNTS counts, and farther than the force limit and a hand move the handle from rest in a
sample. STAIRS of them while force acts, with standing still between them, end the run: a handle that a hand or a blow
moves so fast moves on in the next sample.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, record_at
from hapsim.loop.buffers import scale_force
from hapsim.loop.force_history import IN_ALL, acting_force, history_at
from hapsim.loop.guards.travel import leads_out, travel_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.ring import FADED
from hapsim.number_format import duration
from hapsim.scene import Scene

STAIRCASE = -23
TRUST, MOST_TRUST = 2.0, 8.0  # a hand that keeps pressing at one place is tested less often
COUNTS = 4  # a hand that holds still at the edge of a count moves by one or two
STILL_FACTOR = 3.0  # a trembling hand seldom stands still three times longer than before
MOST_WAIT_S = 0.5  # in less, a weak force takes no handle too far
RAMP_SHARE, LEAST_RAMP_S, MOST_RAMP_S = 0.7, 0.005, 0.15  # with 0.5, counts of 0.1 mm fade three times as often
LEAST_RETURN_S = 0.01  # a faster step of the force feels like a click
LEAST_FORCE = 0.02  # of the force limit: less moves no handle fast, and the dry friction of any device holds it
FRICTION_FACTOR = 2.0  # times dry friction: below, friction and a hand that pushes as hard hold the handle in any test
STAIR_SAMPLES, STAIRS = 3, 3

_EACH = (schema.MAX_CHANNELS,)

FROZEN_SENSOR = np.dtype(
    [
        ("lowered", np.int64),  # channels whose force is lowered now
        ("tests", np.int64),  # tests so far
        ("frozen_ticks", np.int64),  # samples in which a channel had no force because its position stands still
        ("longest", np.int64),  # most samples for which a position stood still without force,
        ("channel", np.int64),  # on this channel
        ("stair_channel", np.int64),  # the channel whose position is a staircase
        ("begun", np.int64),  # 1: there was a sample
        ("rate", np.float64),  # Hz
        ("soft_start", np.float64),  # samples
        ("moved", np.float64, _EACH),  # T²/m, m per N in a sample
        ("floor", np.float64, _EACH),  # N, below which a force proves nothing
        ("travel", np.uint64),  # address of the TRAVEL, if the scene has one
        ("low", np.float64, _EACH),  # m: the travel without its margins, for hands with one channel
        ("high", np.float64, _EACH),
        ("least_way", np.float64, _EACH),  # m, least w for a test,
        ("far", np.float64, _EACH),  # and for one without waiting
        ("place", np.float64, _EACH),  # counts
        ("stair", np.float64, _EACH),  # counts
        ("counts", np.int64, _EACH),  # the position,
        ("still", np.int64, _EACH),  # samples since it changed,
        ("held_at", np.int64, _EACH),  # counts: the place,
        ("held", np.float64, _EACH),  # and there the longest stillness of a live sensor, samples,
        ("trust", np.float64, _EACH),  # and the factor of `far`, from past answers
        ("step", np.float64, _EACH),  # m in a sample: v T,
        ("way", np.float64, _EACH),  # and w
        ("test_age", np.int64, _EACH),  # samples since the test began; -1: no test
        ("ramp", np.float64, _EACH),  # samples of the test
        ("back", np.float64, _EACH),  # samples of the ramp from zero back to the whole force
        ("share", np.float64, _EACH),  # of the force that remains
        ("frozen", np.int64, _EACH),  # 1: the position did not respond
        ("stairs", np.int64, _EACH),  # in a row
    ],
    align=True,
)

_sensor_at = record_at(FROZEN_SENSOR)


@hook
def lower_force(sensor, tick):
    """Lowers force and excitation of hands of which a channel is tested or frozen, whole, so that it does not turn."""
    sensor, tick = _sensor_at(sensor), tick_at(tick)
    if sensor.lowered == 0:
        return 0
    io = io_at(tick.io)
    for c in range(np.uint64(io.channels)):
        share, other = sensor.share[c], c + io.to_next[c]
        while other != c:
            share = min(share, sensor.share[other])
            other += io.to_next[other]
        scale_force(io, c, share)
    tick.flags |= FADED
    return 0


@hook
def judge_sensor(sensor, tick):
    """Judges the positions of the last `gap` samples and the force that will be sent. Returns STAIRCASE for one on the
    channel `sensor.stair_channel`, else 0."""
    sensor, tick = _sensor_at(sensor), tick_at(tick)
    history, io, gap = history_at(tick.history), io_at(tick.io), tick.gap
    code, frozen = 0, 0
    sensor.lowered = 0
    for c in range(io.channels):
        counts = io.position_counts[c]
        frozen |= sensor.frozen[c]
        if sensor.begun == 0:
            sensor.counts[c] = sensor.held_at[c] = counts
        force = io.force_counts[c] * io.force_scale[c]
        position = counts * io.position_scale[c]
        at_end = (force > 0.0 and position >= sensor.high[c]) or (force < 0.0 and position <= sensor.low[c])
        if sensor.travel != 0 and io.to_next[c] != 0:
            at_end = leads_out(travel_at(sensor.travel), io, c, force)
        is_loaded = abs(force) > sensor.floor[c] and not at_end
        if counts != sensor.counts[c]:
            if _has_moved(sensor, c, counts, gap, io.position_scale[c], is_loaded):
                sensor.stair_channel, code = c, STAIRCASE
        else:
            sensor.still[c] += gap
            for before in range(gap - 1 if is_loaded else -1, -1, -1):
                sensor.step[c] += acting_force(history, IN_ALL + c, before) * sensor.moved[c]
                sensor.way[c] += sensor.step[c]
        _test(sensor, c, gap, is_loaded, is_loaded or abs(io.asked[c]) > sensor.floor[c])
        if sensor.frozen[c] and sensor.still[c] > sensor.longest:
            sensor.longest, sensor.channel = sensor.still[c], c
        sensor.lowered += sensor.share[c] < 1.0
    sensor.frozen_ticks += frozen
    sensor.begun = 1
    return code


@helper
def _has_moved(sensor, c, counts, gap, scale, is_loaded):
    """Takes a changed position: the sensor is live. Returns whether it completes a staircase."""
    far, still = abs(counts - sensor.counts[c]), sensor.still[c]
    if still < STAIR_SAMPLES:
        sensor.stairs[c] = 0
    elif is_loaded and gap == 1 and far >= sensor.stair[c]:
        sensor.stairs[c] += 1
    if abs(counts - sensor.held_at[c]) > sensor.place[c]:
        sensor.held_at[c], sensor.held[c], sensor.trust[c] = counts, 0.0, 1.0
    elif sensor.frozen[c] == 0:
        sensor.held[c] = max(sensor.held[c], still + gap)
    sensor.step[c], sensor.way[c] = (counts - sensor.counts[c]) * scale / (still + gap), 0.0
    sensor.counts[c], sensor.still[c] = counts, 0
    if sensor.frozen[c]:
        sensor.back[c] = sensor.soft_start
    elif sensor.test_age[c] >= 0:
        sensor.trust[c] = min(TRUST * sensor.trust[c], MOST_TRUST)
        sensor.back[c] = max(sensor.test_age[c], LEAST_RETURN_S * sensor.rate)
    sensor.frozen[c], sensor.test_age[c] = 0, -1
    return sensor.stairs[c] >= STAIRS


@helper
def _test(sensor, c, gap, is_loaded, scene_pushes):
    """Begins or continues a test, or lets the force return: sets the share of the next force. `scene_pushes`: without
    the test the scene would press."""
    still, share = sensor.still[c], sensor.share[c]
    if sensor.frozen[c]:
        return
    way, waits = abs(sensor.way[c]), still < min(STILL_FACTOR * sensor.held[c], MOST_WAIT_S * sensor.rate)
    is_due = way > sensor.trust[c] * sensor.far[c] or (way > sensor.least_way[c] and not waits)
    if sensor.test_age[c] < 0 and share < 1.0:
        share = min(share + gap / sensor.back[c], 1.0)
    elif sensor.test_age[c] < 0 and is_loaded and is_due:
        sensor.test_age[c] = 0
        sensor.tests += 1
        sensor.ramp[c] = min(max(RAMP_SHARE * still, LEAST_RAMP_S * sensor.rate), MOST_RAMP_S * sensor.rate)
    if sensor.test_age[c] >= 0 and scene_pushes:
        sensor.test_age[c] += gap
        share = 1.0 - sensor.test_age[c] / sensor.ramp[c]
        if share <= 0.0:
            share, sensor.frozen[c], sensor.test_age[c] = 0.0, 1, -1
    sensor.share[c] = share


def _set_up(loop: Any, setting: Setting) -> Any:
    from hapsim.prediction.force_bounds import SOFT_START_S

    if not (setting.in_hand or setting.judges_energy):
        return None
    scene, device, sensor, used = setting.scene, setting.scene.device, loop.frozen_sensor, slice(setting.scene.channels)
    limit, count = loop.io.force_limit[used], np.array(setting.description.position_scale[used])
    scales = device.scales(scene.channels)
    way, far, place, hand = np.transpose([(one.jerk, one.runaway, one.grip, one.grip_force) for one in scales])
    one_sample = scene.rate**-2 / np.array([least for least, _ in device.mass_spans(scene.channels)])
    sensor.moved[used] = one_sample
    sensor.floor[used] = np.maximum(LEAST_FORCE * limit, FRICTION_FACTOR * scene.mock_device.coulomb)
    low, high = np.transpose(device.travels(scene.channels))
    margin = np.array(scene.travel_margins) if device.travel is not None else 0.0
    sensor.travel = address_of(loop.travel) if device.travel is not None else 0
    sensor.low[used], sensor.high[used] = low + margin, high - margin
    sensor.least_way[used], sensor.far[used] = way + COUNTS * count, way + COUNTS * count + far
    sensor.place[used] = np.maximum(place / count, COUNTS)
    sensor.stair[used] = np.maximum((limit + hand) * one_sample / count, COUNTS)
    sensor.rate, sensor.soft_start = scene.rate, (setting.bounds.soft_start_s or SOFT_START_S) * scene.rate
    sensor.test_age[:], sensor.share[:], sensor.trust[:] = -1, 1.0, 1.0
    return sensor


def name_of_hand(scene: Scene, channel: int) -> str:
    """Returns the name of the device point of a channel."""
    return next(name for name, one in scene.device_points.items() if one.channel == channel)


def frozen_sentence(scene: Scene, channel: int, still_s: float) -> str:
    """Returns a sentence about a position that does not respond, without a full stop; "" for `still_s` = 0."""
    if still_s == 0.0:
        return ""
    return (
        f"the position of {name_of_hand(scene, channel)} has not changed by one count for {duration(still_s)} although "
        "force acted: sensor or cable? Its force is zero until it changes. For a handle at a stop declare "
        "device.travel, and for one with dry friction mock.coulomb"
    )


def _sentence(run: EndedRun) -> str:
    hand = name_of_hand(run.scene, int(run.loop.frozen_sensor.stair_channel))
    return (
        f"the position of {hand} stands still and jumps, again and "
        f"again, the last time at tick {run.report.ticks}: its sensor is refreshed more rarely than device.rate says, "
        "or its cable is loose; the last force was not sent (hapsim/STABILITY.md)"
    )


GUARD = Guard(
    "frozen_sensor",
    FROZEN_SENSOR,
    {Stage.LOWER: lower_force, Stage.JUDGE: judge_sensor},
    _set_up,
    STAIRCASE,
    "position a staircase",
    _sentence,
    reads_history=True,
    mode="impedance",  # else commands, not forces, move the handle: following.py
)
