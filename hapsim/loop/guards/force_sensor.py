"""The guard of the force sensor of a device in admittance: a wrong force moves the handle, whatever the hand wants.

**Offset.** The command stands still until the positions of SETTLE_S have come (command_limit.py). The mean of the force
sensed with them is taken off every later one. Beyond SHARE of the sensor's range a hand may lean on the handle, and the
run ends before it moves.

**Saturated**: at FULL of its range for SATURATED_S. **Dead**: its count has not changed while the command went DEAD_WAY
of a visible motion, within DEAD_S at least, although it shows a force, or showed noise while the handle stood still.
**Drifting**: over QUIET windows of WINDOW_S in a row it showed a force that was as steady, beside a trend, as while the
handle stood still, and moved the command all along: a hand trembles, and takes its force back.

**Inverted.** The force itself does not show its sign: a hand pushes along its motion, too, and the mass that a force
moves answers every force alike. But where the command does not follow the force, the force answers the motion as hand
and handle do,

    f = c + c' t - k x - b v - m a,    k, b, m >= 0,

with c + c' t for what the hand does by itself. So if the force has pushed along a motion of PUSHED, the guard stops the
command for some milliseconds, a test that the hand does not expect, and fits f of the times before and in the test:
with k, b, m >= 0, residual R(right), and with k, b, m <= 0, R(wrong). The ratio (R(right) - R(wrong)) / (R(wrong) +
noise) above SURE is wrong, the other ratio right; TESTS in a row decide. A sensor that is right is tested no more.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling import helper
from hapsim.compiling.native import address_of, record_at
from hapsim.loop.guards.command_limit import command_limit_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.simulated_mass import admittance_at

BAD_FORCE = -32
LEANS, SATURATED, DEAD, DRIFTS, INVERTED = 1, 2, 3, 4, 5

SETTLE_S, SETTLE_SAMPLES, SHARE = 0.05, 32, 0.05
FULL, SATURATED_S, SATURATED_SAMPLES = 0.99, 0.01, 5
DEAD_S, DEAD_SAMPLES = 0.1, 32
WINDOW_S, QUIET, SHOWN = 0.25, 8, 0.01  # the last: of the range, a force that is more than the sensor's errors
PUSHED, BEFORE_S, TEST_S, APART_S = 0.4, 0.008, 0.014, 0.06  # the first: of a visible motion
SETTLED, ROWS, PERIOD_S = 3.0, 128, 1e-3  # times constants of the servo; samples of a test, and at least so far apart
SURE, TESTS = 6.0, 2
LEAST_RATE_HZ = 500.0  # below, a test is too long beside what a hand does by itself
TERMS, TREND = 6, 2  # 1, t, x, v, a and f; of these, what a hand does by itself
_SWEEPS = 40  # of the fit, one coefficient at a time

_EACH, _ROWS = (schema.MAX_CHANNELS,), (ROWS * schema.MAX_CHANNELS,)

FORCE_SENSOR = np.dtype(
    [
        ("admittance", np.uint64),  # address of the ADMITTANCE,
        ("limit", np.uint64),  # and of the COMMAND_LIMIT
        ("settles", np.int64),  # positions from arming on in which the handle stands still
        ("why", np.int64),  # LEANS, SATURATED, DEAD, DRIFTS, INVERTED
        ("channel", np.int64),
        # Of each channel:
        ("offset", np.float64, _EACH),  # N
        ("range", np.float64, _EACH),  # N
        ("visible", np.float64, _EACH),  # m, a motion that is seen
        ("count", np.int64, _EACH),  # the last one,
        ("still", np.int64, _EACH),  # samples since it changed,
        ("way", np.float64, _EACH),  # and m that the command went since
        ("low", np.int64, _EACH),  # counts: the least and the largest while the handle stood still
        ("high", np.int64, _EACH),
        ("saturated", np.int64, _EACH),  # samples in a row
        ("window", np.int64),  # samples in this window
        ("window_low", np.int64, _EACH),
        ("window_high", np.int64, _EACH),
        ("window_first", np.int64, _EACH),
        ("window_way", np.float64, _EACH),  # m, along the force, of these windows
        ("quiet", np.int64, _EACH),  # windows in a row
        # Of a test of the sign:
        ("judges_sign", np.int64),
        ("stride", np.int64),  # samples from one that is kept to the next
        ("before", np.int64),  # samples that are kept before a test,
        ("lasts", np.int64),  # and in it
        ("apart", np.int64),  # samples from the beginning of a test to the next
        ("force", np.float64, _ROWS),  # N, of the last samples, a row for each channel,
        ("position", np.float64, _ROWS),  # m
        ("newest", np.int64),  # where the last ones are
        ("pushed", np.float64, _EACH),  # m that the force pushed along, up to now
        ("age", np.int64, _EACH),  # samples since a test began
        ("is_tested", np.int64, _EACH),
        ("right", np.int64, _EACH),  # tests in a row
        ("wrong", np.int64, _EACH),
        ("tests", np.int64),
        ("products", np.float64, (TERMS * TERMS,)),  # of the terms, over a test
        ("values", np.float64, (TERMS,)),  # of the terms in a sample, or their coefficients
    ],
    align=True,
)

_sensor_at = record_at(FORCE_SENSOR)


@hook
def take_offset(sensor, tick):
    """Takes the offset off the sensed force; while it is not known, all of it. Returns BAD_FORCE if it is too large."""
    sensor, tick = _sensor_at(sensor), tick_at(tick)
    io = io_at(tick.io)
    code = 0
    for c in range(np.uint64(io.channels)):
        count = io.hand_force_counts[c]
        if tick.number >= sensor.settles:
            io.hand_force[c] -= sensor.offset[c]
            if tick.number == sensor.settles and abs(sensor.offset[c]) > SHARE * sensor.range[c]:
                code = _end(sensor, c, LEANS)
            continue
        sensor.low[c] = count if tick.number == 0 else min(sensor.low[c], count)
        sensor.high[c] = count if tick.number == 0 else max(sensor.high[c], count)
        sensor.offset[c] += (io.hand_force[c] - sensor.offset[c]) / (tick.number + 1)
        io.hand_force[c] = 0.0
    return code


@helper
def _end(sensor, c, why):
    sensor.why, sensor.channel = why, np.int64(c)
    return BAD_FORCE


@hook
def judge_force(sensor, tick):
    """Judges the sensed force of each channel, and begins and ends tests. Returns BAD_FORCE or 0."""
    sensor, tick = _sensor_at(sensor), tick_at(tick)
    io, admittance, limit = io_at(tick.io), admittance_at(sensor.admittance), command_limit_at(sensor.limit)
    is_settled, gap, code = tick.number >= sensor.settles, tick.gap, 0
    if tick.sample // sensor.stride != (tick.sample - gap) // sensor.stride:
        sensor.newest = (sensor.newest + 1) % ROWS
    sensor.window += gap
    ends_window = sensor.window >= sensor.apart * WINDOW_S / APART_S
    for c in range(np.uint64(io.channels)):
        force, step = io.hand_force[c], admittance.place[c] - admittance.before[c]
        row = np.uint64(sensor.newest + ROWS * np.int64(c))
        sensor.force[row], sensor.position[row] = force, io.position_counts[c] * io.position_scale[c]
        shows = abs(force) > SHOWN * sensor.range[c]
        why = _judge_count(sensor, io, c, gap, step, shows) if is_settled else 0
        if ends_window:
            quiet = _end_window(sensor, io, c, shows and is_settled)
            why = DRIFTS if why == 0 and quiet >= QUIET else why
        if is_settled and sensor.judges_sign and sensor.right[c] < TESTS:
            why = INVERTED if _test(sensor, limit, io, c, gap, force * step, step) and why == 0 else why
        code = _end(sensor, c, why) if why != 0 else code
    sensor.window = 0 if ends_window else sensor.window
    return code


@helper
def _judge_count(sensor, io, c, gap, step, shows):
    """Returns SATURATED, DEAD or 0. `step`: m of the command; `shows`: a force is there."""
    count, apart = io.hand_force_counts[c], sensor.apart / APART_S
    raw = abs(count * io.hand_force_scale[c])
    sensor.saturated[c] = sensor.saturated[c] + gap if raw >= FULL * sensor.range[c] else 0
    sensor.window_low[c], sensor.window_high[c] = min(sensor.window_low[c], count), max(sensor.window_high[c], count)
    sensor.window_way[c] += abs(step) if io.hand_force[c] * step >= 0.0 else -math.inf  # not one step back
    if count != sensor.count[c]:
        sensor.count[c], sensor.still[c], sensor.way[c] = count, 0, 0.0
    sensor.still[c] += gap
    sensor.way[c] += abs(step)
    if sensor.saturated[c] > max(SATURATED_S * apart, SATURATED_SAMPLES):
        return SATURATED
    is_dead = sensor.still[c] > max(DEAD_S * apart, DEAD_SAMPLES) and sensor.way[c] > sensor.visible[c]
    return DEAD if is_dead and (shows or sensor.high[c] > sensor.low[c]) else 0


@helper
def _end_window(sensor, io, c, shows):
    """Ends a window. Returns how many in a row were as quiet as a handle that nobody holds, and showed a force."""
    spread, still = sensor.window_high[c] - sensor.window_low[c], sensor.high[c] - sensor.low[c]
    trend = abs(io.hand_force_counts[c] - sensor.window_first[c])
    is_quiet = shows and spread - trend <= 3 * still + 2 and sensor.window_way[c] > 0.0
    sensor.quiet[c] = sensor.quiet[c] + 1 if is_quiet else 0
    sensor.window_way[c] = sensor.window_way[c] if is_quiet else 0.0
    sensor.window_low[c] = sensor.window_high[c] = sensor.window_first[c] = io.hand_force_counts[c]
    return sensor.quiet[c] if sensor.window_way[c] > sensor.visible[c] else 0


@helper
def _test(sensor, limit, io, c, gap, power, step):
    """Begins, continues or ends a test. Returns whether it shows, as the one before, that the sign is wrong."""
    sensor.age[c] += gap
    if limit.stopped[c] == 0:
        sensor.pushed[c] = sensor.pushed[c] + abs(step) if power > 0.0 else 0.0
        is_due = sensor.pushed[c] > PUSHED * sensor.visible[c]
        if is_due and (sensor.age[c] > sensor.apart or sensor.wrong[c] > 0):
            limit.stopped[c], sensor.age[c] = 1, 0
            sensor.tests += 1
        return False
    if sensor.age[c] < sensor.lasts * sensor.stride:
        return False
    limit.stopped[c], sensor.pushed[c] = 0, 0.0
    least = (io.hand_force_scale[c] * max(sensor.high[c] - sensor.low[c], 1)) ** 2 / 12.0
    _fit(sensor, c)
    right, wrong = _left(sensor, -1.0), _left(sensor, 1.0)
    noise = (sensor.before + sensor.lasts) * least
    is_wrong, is_right = right - wrong > SURE * (wrong + noise), wrong - right > SURE * (right + noise)
    sensor.wrong[c] = sensor.wrong[c] + 1 if is_wrong else 0 if is_right else sensor.wrong[c]
    sensor.right[c] = sensor.right[c] + 1 if is_right else 0 if is_wrong else sensor.right[c]
    return sensor.wrong[c] >= TESTS


@helper
def _add_sample(sensor, c, i):
    """Adds to the products of a test those of 1, t, x, v, a and f, `i` kept samples ago."""
    of = ROWS * np.int64(c)
    at, before = of + (sensor.newest - i) % ROWS, of + (sensor.newest - i - 1) % ROWS
    first, oldest = of + (sensor.newest - i - 2) % ROWS, of + sensor.newest
    x, one, two = sensor.position[at], sensor.position[before], sensor.position[first]
    values = sensor.values
    values[0], values[1], values[2] = 1.0, np.float64(i), x - sensor.position[oldest]
    values[3], values[4], values[5] = x - one, x - one - one + two, sensor.force[at]
    for j in range(TERMS):
        for k in range(TERMS):
            sensor.products[np.uint64(TERMS * j + k)] += values[np.uint64(j)] * values[np.uint64(k)]


@helper
def _fit(sensor, c):
    """Makes of a test's products those of x, v, a and f without their means and trends."""
    products = sensor.products
    products[:] = 0.0
    for i in range(sensor.before + sensor.lasts):
        _add_sample(sensor, c, i)
    for pivot in range(TREND):
        for j in range(pivot + 1, TERMS):
            share = products[np.uint64(TERMS * j + pivot)] / products[np.uint64((TERMS + 1) * pivot)]
            for k in range(TERMS):
                products[np.uint64(TERMS * j + k)] -= share * products[np.uint64(TERMS * pivot + k)]


@helper
def _left(sensor, sign):
    """Returns the squares, N², that k, b and m of one sign leave of a test's forces."""
    products, found, f = sensor.products, sensor.values, TERMS - 1
    for j in range(TERMS):
        found[np.uint64(j)] = 0.0
    left = products[np.uint64((TERMS + 1) * f)]
    for _ in range(_SWEEPS):
        for j in range(TREND, f):
            along = products[np.uint64(TERMS * j + f)]
            for k in range(TREND, f):
                along -= products[np.uint64(TERMS * j + k)] * found[np.uint64(k)]
            own = products[np.uint64((TERMS + 1) * j)]
            if own > 0.0:
                best = sign * max(sign * (found[np.uint64(j)] + along / own), 0.0)
                left -= (best - found[np.uint64(j)]) * (2.0 * along - (best - found[np.uint64(j)]) * own)
                found[np.uint64(j)] = best
    return max(left, 0.0)


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, sensor, used = setting.scene, loop.force_sensor, slice(setting.scene.channels)
    if not (setting.in_hand or setting.judges_sign):
        return None
    servos = [
        1.0 / (2.0 * math.pi * one.bandwidth * min(one.damping, 1.0))
        for one in scene.device.servos(scene.channels)
        if one
    ]
    sensor.admittance, sensor.limit = address_of(loop.admittance), address_of(loop.command_limit)
    sensor.settles = max(round(SETTLE_S * scene.rate), SETTLE_SAMPLES)
    loop.command_limit.held = sensor.settles
    sensor.range[used] = setting.description.hand_force_range[used]
    sensor.visible[used] = [one.jerk for one in scene.device.scales(scene.channels)]
    sensor.judges_sign = scene.rate >= LEAST_RATE_HZ
    sensor.stride = max(round(PERIOD_S * scene.rate), 1)
    kept_hz = scene.rate / sensor.stride
    sensor.before, sensor.apart = max(round(BEFORE_S * kept_hz), 4), round(APART_S * scene.rate)
    lasts = round((TEST_S + SETTLED * max(servos, default=0.0)) * kept_hz)
    sensor.lasts = min(lasts, ROWS - 3 - sensor.before)
    sensor.age[:] = sensor.apart
    return sensor


_FOUND = {
    LEANS: "shows {force} at arming, more than {share:.0%} of its range of {range}: something presses on the handle, "
    "or the sensor needs its zero",
    SATURATED: "is at the end of its range of {range}",
    DEAD: "stands still at {count} counts while the handle moves: sensor or cable?",
    DRIFTS: "shows {force}, as steadily as without a hand, and moves the handle: it drifts, or something hangs on the "
    "handle",
    INVERTED: "has the wrong sign: it pushes along each motion that was stopped for a test",
}


def _sentence(run: EndedRun) -> str:
    sensor, c = run.loop.force_sensor, int(run.loop.force_sensor.channel)
    units, io = run.scene.units_of(c), run.loop.io
    force = sensor.offset[c] if sensor.why == LEANS else io.hand_force[c]
    found = _FOUND[int(sensor.why)].format(
        force=units(force, "N", ".3g"),
        range=units(sensor.range[c], "N", ".3g"),
        share=SHARE,
        count=int(io.hand_force_counts[c]),
    )
    return f"the force sensor of {run.scene.hand_on(c)} {found} (tick {run.report.ticks})"


GUARD = Guard(
    "force_sensor",
    FORCE_SENSOR,
    {Stage.READ: take_offset, Stage.JUDGE: judge_force},
    _set_up,
    BAD_FORCE,
    "force sensor wrong",
    _sentence,
    mode="admittance",
)
