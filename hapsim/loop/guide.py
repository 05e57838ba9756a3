"""A guide leads one hand to a place before it is excited, and then holds it there by a constant force.

The guide is a spring, a damper and an integrator. They follow a path of minimum jerk from where the hand is at arming
to the target, or where the scene has dry friction, a little beyond it and back, so that its bristles are not bent. The
integrator makes up for the scene's force, gravity and the device's friction, so that no model of them is needed. It
stops after the settling time; the mean of the guide's force over the time that follows is the bias. The guide then
crossfades to this bias, which stays until the run ends: the hand rests, and feels the scene alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hapsim.compiling import helper
from hapsim.compiling.native import record_at
from hapsim.loop.buffers import clip
from hapsim.loop.hooks import Hook, Stage, hook, io_at, tick_at

_SMOOTHED = 5.0  # times the spring's eigenfrequency: the low-pass of its damper, which would be loud on a noisy device
_SUMMED = 3.0  # radians of the spring's eigenfrequency, in which the integrator adds as much as the spring has

GUIDE = np.dtype(
    [
        ("channel", np.uint64),
        ("target", np.float64),  # m
        ("beyond", np.float64),  # m, how far the path goes beyond it before
        ("ramp", np.int64),  # ticks of the path,
        ("settling", np.int64),  # of the integrator beyond it,
        ("mean", np.int64),  # of the mean,
        ("fade", np.int64),  # and of the crossfade
        ("tick", np.int64),
        ("stiffness", np.float64),  # N/m
        ("damping", np.float64),  # N/m, in a sample
        ("summing", np.float64),  # N/m, in a sample
        ("begun", np.float64),  # m, where the hand was at arming,
        ("before", np.float64),  # its position less the path's, at the last tick,
        ("velocity", np.float64),  # and what it changes by in a tick, low-passed, m
        ("follows", np.float64),  # by which share of a change a tick
        ("summed", np.float64),  # N, of the integrator
        ("bias", np.float64),  # N
    ],
    align=True,
)

_guide_at = record_at(GUIDE)


@hook
def lead(guide, tick):
    """Sets the push to the guide's force in N, one tick on."""
    guide, tick = _guide_at(guide), tick_at(tick)
    tick.push = _force(guide, io_at(tick.io))
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
    path = guide.begun + (guide.target + beyond - guide.begun) * _way(tick / guide.ramp)
    off = x - path + beyond * _way(2.0 * (tick - guide.ramp) / guide.settling)
    if tick == 0:
        guide.before = off
    if tick < settled:
        guide.summed = clip(guide.summed - guide.summing * off, io.force_limit[guide.channel])
    guide.velocity += guide.follows * (off - guide.before - guide.velocity)
    guide.before = off
    force = guide.summed - guide.stiffness * off - guide.damping * guide.velocity
    if tick < settled:
        return force
    since = tick - settled
    if since < guide.mean:
        guide.bias += force / guide.mean
        return force
    share = (since - guide.mean + 1.0) / guide.fade
    return guide.bias + (1.0 - share) * (force - guide.bias)


@helper
def _way(share):
    """The share of a path of minimum jerk behind a hand, after this share of its time."""
    s = min(max(share, 0.0), 1.0)
    return s * s * s * (10.0 - 15.0 * s + 6.0 * s * s)


def guide_hook(
    record: Any,
    *,
    channel: int,
    target: float,
    beyond: float,
    ticks: Sequence[int],
    rate_hz: float,
    stiffness: float,
    mass: float,
) -> Hook:
    """Fills a GUIDE, and returns the hook that leads. `target`: m; `beyond`: m, how far the path goes farther before;
    `ticks`: of the path, of the integrator beyond it, of the mean and of the crossfade; `stiffness`: N/m, of the
    spring; `mass`: kg, which it leads."""
    angular = math.sqrt(stiffness / mass)
    record.channel, record.target, record.beyond, record.stiffness = channel, target, beyond, stiffness
    record.ramp, record.settling, record.mean, record.fade = ticks
    record.damping = 2.0 * mass * angular * rate_hz
    record.follows = -math.expm1(-_SMOOTHED * angular / rate_hz)
    record.summing = stiffness * angular / (_SUMMED * rate_hz)
    return Hook(Stage.LEAD, lead, record)
