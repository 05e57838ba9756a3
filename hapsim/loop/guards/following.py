"""The following guard of a device in admittance: the handle is where its commands lead, or the run ends.

A servo whose motor or encoder has the wrong sign runs away; one that is off, or whose position sensor is dead, stays.
For commands X that the servo follows with the bandwidth w and the damping z, the position x is behind by at most

    abs(X - x) <= (2 z + 1/z) / w · max abs(X'),

the integral of the size of its response, and by the delay, the sample that a command lasts and those that were late.
The guard allows SLACK times that for the fastest of the last motion, and beside it the error of a position sensor, the
mock's noise and some counts.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from firmware_protocol import schema
from hapsim.compiling.native import address_of, record_at
from hapsim.loop.guards.leap import NOISE_RMS
from hapsim.loop.hooks import EndedRun, Guard, Setting, Stage, hook, io_at, tick_at
from hapsim.loop.simulated_mass import admittance_at

DOES_NOT_FOLLOW = -33

SLACK = 2.0
_FADES = 4.0  # lags in which the fastest motion is forgotten to 1/e
_COUNTS = 4.0

_EACH = (schema.MAX_CHANNELS,)

FOLLOWING = np.dtype(
    [
        ("admittance", np.uint64),  # address of the ADMITTANCE
        ("lag", np.float64, _EACH),  # samples by which the position is behind the command
        ("unsure", np.float64, _EACH),  # m, error of the position
        ("fastest", np.float64, _EACH),  # m in a sample, which fades
        ("channel", np.int64),  # which does not follow,
        ("off", np.float64),  # m, how far it is off,
        ("bound", np.float64),  # m, and may be
    ],
    align=True,
)

_following_at = record_at(FOLLOWING)


@hook
def judge_following(following, tick):
    """Returns DOES_NOT_FOLLOW for a position too far from its commands, else 0."""
    following, tick = _following_at(following), tick_at(tick)
    io, admittance, code = io_at(tick.io), admittance_at(following.admittance), 0
    for c in range(np.uint64(io.channels)):
        lag, place = following.lag[c] + tick.age + tick.gap, admittance.place[c]
        faded = following.fastest[c] * math.exp(-tick.gap / (_FADES * lag))
        following.fastest[c] = max(faded, abs(place - admittance.before[c]))
        off = abs(place - io.position_counts[c] * io.position_scale[c])
        bound = SLACK * lag * following.fastest[c] + following.unsure[c]
        if off > bound:
            following.channel, following.off, following.bound, code = np.int64(c), off, bound, DOES_NOT_FOLLOW
    return code


def _set_up(loop: Any, setting: Setting) -> Any:
    scene, following, used = setting.scene, loop.following, slice(setting.scene.channels)
    servo, following.lag[used] = setting.description.servo, scene.device.delay
    if servo is None or not (setting.in_hand or setting.judges_sign):
        return None
    following.admittance = address_of(loop.admittance)
    for c in range(scene.channels):  # the servo of the registers: one that is identified may have none in its scene
        if hz := servo.bandwidth_hz[c]:
            ratio = servo.damping[c] or 1.0
            following.lag[c] += scene.rate * (2.0 * ratio + 1.0 / ratio) / (2.0 * math.pi * hz)
    sensor = np.array([one.sensor for one in scene.device.scales(scene.channels)])
    counts = np.array(setting.description.position_scale[used])
    following.unsure[used] = sensor + NOISE_RMS * scene.mock_device.noise + _COUNTS * counts
    return following


def _sentence(run: EndedRun) -> str:
    following, c, io = run.loop.following, int(run.loop.following.channel), run.loop.io
    units = run.scene.units_of(c)
    place = units(io.position_counts[c] * io.position_scale[c], "m", ".4g")
    return (
        f"{run.scene.hand_on(c)} does not follow its commands: at tick {run.report.ticks} it is at {place}, "
        f"{units(following.off, 'mm', '.3g')} from where they lead, and its servo is at most "
        f"{units(following.bound, 'mm', '.3g')} behind. A motor or an encoder with the wrong sign, a dead position "
        "sensor, a handle that is stuck, or a servo and a delay that are not the device's: `hapsim "
        "identify` finds these, with no hand on the handle"
    )


GUARD = Guard(
    "following",
    FOLLOWING,
    {Stage.JUDGE: judge_following},
    _set_up,
    DOES_NOT_FOLLOW,
    "commands not followed",
    _sentence,
    stopped_motor=lambda loop: int(loop.following.channel),
    mode="admittance",
)
