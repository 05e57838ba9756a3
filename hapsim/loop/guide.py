"""The guide: it leads one hand to a target before the excitation, and then holds it there by a constant force. In the
plane each coordinate has its own guide; all follow one clock, so that the path is straight.

The guide is a spring, a damper and an integrator. They follow a path of minimum jerk from the hand's position at arming
to the target. In a scene with dry friction the path goes a little beyond the target and back, so that no bristle stays
bent. The integrator compensates the scene's force, gravity and the device's friction, so that no model of them is
needed. It stops after the settling time. The mean of the guide's force over the following time is the bias. The guide
then crossfades to this bias, which stays until the run ends: the hand rests, and feels the scene alone.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from hapsim.compiling import helper
from hapsim.compiling.native import record_at
from hapsim.loop.buffers import clip
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at

_LOW_PASS_RATIO = 5.0  # cut-off of the damper's low-pass over the spring's eigenfrequency, against a noisy device
_INTEGRAL_ANGLE = 3.0  # radians of the spring's eigenfrequency in which the integrator adds as much as the spring has

GUIDE = np.dtype(
    [
        ("channel", np.uint64),
        ("target", np.float64),  # m
        ("beyond", np.float64),  # m, the path's overshoot
        ("ramp", np.int64),  # ticks of the path,
        ("settling", np.int64),  # of the integrator beyond it,
        ("mean", np.int64),  # of the mean,
        ("fade", np.int64),  # and of the crossfade
        ("tick", np.int64),
        ("stiffness", np.float64),  # N/m
        ("damping", np.float64),  # N/m, in a sample
        ("integral_gain", np.float64),  # N/m, in a sample
        ("begun", np.float64),  # m, the hand's position at arming,
        ("before", np.float64),  # its position less the path's, at the last tick,
        ("velocity", np.float64),  # and the low-passed change of that in a tick, m
        ("low_pass", np.float64),  # share of a change per tick
        ("integral", np.float64),  # N, of the integrator
        ("bias", np.float64),  # N
    ],
    align=True,
)

_guide_at = record_at(GUIDE)


@hook
def lead(guide, tick):
    """Sets its channel's push to the guide's force (N) of this tick."""
    guide, tick = _guide_at(guide), tick_at(tick)
    tick.push[guide.channel] = _force(guide, io_at(tick.io))
    return 0


@helper
def _force(guide, io):
    x = io.measured[guide.channel]
    tick, settled = guide.tick, guide.ramp + guide.settling
    guide.tick += 1
    if tick >= settled + guide.mean + guide.fade:
        return guide.bias
    if tick == 0:
        guide.begun = x
    beyond = guide.beyond if guide.target >= guide.begun else -guide.beyond
    path = guide.begun + (guide.target + beyond - guide.begun) * _minimum_jerk(tick / guide.ramp)
    off = x - path + beyond * _minimum_jerk(2.0 * (tick - guide.ramp) / guide.settling)
    if tick == 0:
        guide.before = off
    if tick < settled:
        guide.integral = clip(guide.integral - guide.integral_gain * off, io.force_limit[guide.channel])
    guide.velocity += guide.low_pass * (off - guide.before - guide.velocity)
    guide.before = off
    force = guide.integral - guide.stiffness * off - guide.damping * guide.velocity
    if tick < settled:
        return force
    since = tick - settled
    if since < guide.mean:
        guide.bias += force / guide.mean
        return force
    share = (since - guide.mean + 1.0) / guide.fade
    return guide.bias + (1.0 - share) * (force - guide.bias)


@helper
def _minimum_jerk(share):
    """Returns the completed share of a path of minimum jerk after this share of its time."""
    s = min(max(share, 0.0), 1.0)
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


def guide_hook(record: Any, guide: Any, to: tuple[int, float, float], *, rate_hz: float, mass: float) -> Hook:
    """Fills a GUIDE and returns its hook. `guide`: a Guide of hapsim.running. `to`: channel, target and the path's
    overshoot, m. `mass`: kg, of hand and device."""
    stiffness, angular = guide.stiffness, math.sqrt(guide.stiffness / mass)
    (record.channel, record.target, record.beyond), record.stiffness = to, stiffness
    record.ramp, record.settling, record.mean, record.fade = guide.ticks(rate_hz)
    record.damping = 2.0 * mass * angular * rate_hz
    record.low_pass = -math.expm1(-_LOW_PASS_RATIO * angular / rate_hz)
    record.integral_gain = stiffness * angular / (_INTEGRAL_ANGLE * rate_hz)
    return Hook(Stage.LEAD, lead, record)
