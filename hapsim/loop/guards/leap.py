"""The leap guard: it stops the loop before it answers a position that no force or blow can have caused.

`_set_up` has the bound; STABILITY.md explains it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling.native import record_at
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.number_format import rounded_down
from hapsim.scene import Scene

POSITION_LEAPT = -20

LEAST_MASS = 0.1  # of the declared one, for a released handle. It also allows blows of ten times a hand's force
_COUNTS, _NEAR_END = 2.0**31, 0.99  # on either side; a count that wraps round was near the end a sample before
NOISE_RMS = 20.0  # noise is above 8 rms in one sample of 1e15 (a second difference has 2.45 rms)

_EACH = (schema.MAX_CHANNELS,)

LEAP = np.dtype(
    [
        ("channels", np.int64),  # count of judged channels
        ("by_host", np.int64),  # 1: the host paces, so that samples differ in length
        ("period_ns", np.int64),
        ("last", np.float64, _EACH),  # m, the last measured position
        ("span", np.float64),  # sample periods from the position before the last to the last
        ("pace", np.float64, _EACH),  # m per sample period, of the last step,
        ("pace_before", np.float64, _EACH),  # and of the one before
        ("begun_ns", np.int64),  # beginning of the tick whose force requested the last position
        ("acceleration", np.float64, _EACH),  # m per sample period squared, by all forces together,
        ("spring", np.float64, _EACH),  # and by the device's own spring, per m of stretch
        ("friction_share", np.float64, _EACH),  # share of the pace that the device's friction may remove in a period
        ("reversal", np.float64, _EACH),  # m per sample period: fastest that a blow reverses
        ("sensor", np.float64, _EACH),  # m
        ("leapt_m", np.float64),  # the leap,
        ("bound_m", np.float64),  # its bound,
        ("channel", np.int64),  # and its channel
    ],
    align=True,
)


_leap_at = record_at(LEAP)


@hook
def find_leap(leap, tick):
    """Judges the position in `io.measured`: POSITION_LEAPT or 0. The first two positions may have any speed."""
    leap, tick = _leap_at(leap), tick_at(tick)
    io = io_at(tick.io)
    periods = np.float64(tick.gap)
    if leap.by_host:
        # The device samples on request. The longer of two times counts: either may be delayed. A request is timed
        # before it is sent: the device may answer while the host is held up behind the sending.
        requested, received = tick.begun_ns - leap.begun_ns, tick.now_ns - tick.before_ns
        elapsed = np.float64(requested if requested > received else received) / leap.period_ns
        leap.begun_ns = tick.begun_ns
        periods = elapsed if elapsed > periods else periods
    mean = 0.5 * (periods + leap.span)
    leap.span = periods
    code = 0
    for c in range(np.uint64(leap.channels)):
        last = leap.last[c]
        leap.last[c] = io.measured[c]
        step = io.measured[c] - last
        off = abs(step - leap.pace[c] * periods)
        # The faster of the last two steps, since a blow within the last one has slowed it.
        now_at, before = abs(leap.pace[c]), abs(leap.pace_before[c])
        speed = now_at if now_at > before else before
        leap.pace_before[c] = leap.pace[c]
        leap.pace[c] = step / periods
        turned = 2.0 * (speed if speed < leap.reversal[c] else leap.reversal[c])
        slowed = leap.friction_share[c] * mean
        bound = leap.sensor[c] + periods * (
            turned
            + (slowed if slowed < 1.0 else 1.0) * speed
            + mean * (leap.acceleration[c] + leap.spring[c] * (abs(last) + speed * mean))
        )
        if off > bound and tick.number > 1:
            leap.leapt_m, leap.bound_m, leap.channel = off, bound, c
            code = POSITION_LEAPT
    return code


def _set_up(loop: Any, setting: Setting) -> Any:
    """Fills the LEAP of a LOOP: each value from the scene's device or its mock, whichever allows larger steps.

    With A = (all forces + hand_force) / (LEAST_MASS m), m the least declared mass, T the sample period, v the larger
    speed of the last two steps, a position may be off the line through the two before it by

        A T² + 2 min(v, hand_speed) T + min(1, b0 T / (LEAST_MASS m)) v T + k0 T² / (LEAST_MASS m) abs(x) + S

    with S = sensor + NOISE_RMS noise + 4 counts. After lost positions the bound grows with the time.
    """
    scene, channels, leap = setting.scene, setting.scene.channels, loop.leap
    device, mock, period, by_host = scene.device, scene.mock_device, 1.0 / scene.rate, scene.device.clock == "host"
    least = LEAST_MASS * np.minimum([least for least, _ in device.mass_spans(channels)], mock.mass)
    friction = np.maximum(device.frictions(channels), mock.friction)
    scales, counts = device.scales(channels), np.array(setting.description.position_scale[:channels])
    hand_force, speed, sensor = np.transpose([(one.hand_force, one.hand_speed, one.sensor) for one in scales])
    leap.channels, leap.by_host, leap.span, leap.period_ns = channels, by_host, 1.0, round(1e9 * period)
    with np.errstate(over="ignore"):
        leap.acceleration[:channels] = (device.force_limit + mock.coulomb + hand_force) / least * period**2
        leap.spring[:channels] = np.maximum(device.stiffnesses(channels), mock.stiffness) / least * period**2
        # Where the host paces, the length of a sample is uncertain: a whole step may be wrong.
        leap.friction_share[:channels] = 1.0 if by_host else friction / least * period
        leap.reversal[:channels] = speed * period
        leap.sensor[:channels] = sensor + NOISE_RMS * mock.noise + 4.0 * counts
    return leap


def _sentence(run: EndedRun) -> str:
    leap = run.loop.leap
    units = run.scene.units_of(int(leap.channel))
    bound = units(leap.bound_m, "m", rounded_down)
    return (
        f"the position of channel {leap.channel} leapt at tick {run.report.ticks}: {units(leap.leapt_m, 'm', '.4g')} "
        f"away from where its motion led, where no hand gets farther than {bound} (hapsim/STABILITY.md); its force was "
        "not sent. A loose cable, a sensor or counter that jumps, or a position scale, a mass or a force_limit that is "
        f"not the device's{at_end_of_counts(run.loop.io, run.scene, _NEAR_END)}"
    )


def at_end_of_counts(io: Any, scene: Scene, near: float = 0.0) -> str:
    """Returns a sentence if a channel's count exceeds the share `near` of its range, else "". `io`: IO_BUFFER."""
    counts = [abs(int(io.position_counts[c]) + int(io.origin_counts[c])) for c in range(io.channels)]
    c = max(range(io.channels), key=lambda one: counts[one])
    if counts[c] < near * _COUNTS:
        return ""
    scale, units = float(io.position_scale[c]), scene.units_of(c)
    return (
        f". The position's count is at its end on channel {c} (±{units(_COUNTS * scale, 'm', '.4g')} at "
        f"{units(scale, 'm', 'g')} per count): the device went as far as 32 bits reach. Keep it within by a spring, a "
        "stop or device.travel, or make its counts larger: mock.quantum, or the position scale of a device's firmware"
    )


GUARD = Guard("leap", LEAP, {Stage.READ: find_leap}, _set_up, POSITION_LEAPT, "position leapt", _sentence)
