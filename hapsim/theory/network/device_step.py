"""One device channel over one sample period, exactly: the real mass, moved by the hold from sample to sample.

Lengths in metres, times in sample periods, forces as T²/m f. By the matrix exponential, so that nothing is
shared with the transforms of ``plant.py``, against which it is a check.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.interface import HOLDS, whole_and_fraction

POSITION, VELOCITY, FORCE, TRAVEL, SLOPE = range(5)  # TRAVEL: the position's integral over the period
TAYLOR_TERMS = 18  # for a norm of a half: beyond rounding


class DeviceStep(NamedTuple):
    """What one sample period makes of a channel.

    ``motion`` (3, 2): new position, velocity and mean position from the position and velocity before.
    ``forces`` (3, ages): the same from the computed forces, by their age in whole samples, the newest first.
    """

    motion: Floats
    forces: Floats


def device_step(damping: float, delay: float, hold: str, stiffness: float = 0.0) -> DeviceStep:
    """The step of a mass with the normalised friction b0 T/m and own spring k0 T²/m, and a delay in sample periods."""
    whole, fraction = whole_and_fraction(delay)
    segments = [segment for segment in HOLDS[hold].segments(fraction) if segment.duration > 0.0]
    ages = max(len(weights) for segment in segments for weights in (segment.kick, segment.level, segment.slope))
    forces = np.zeros((5, whole + ages))
    motion = np.eye(5)[:, [POSITION, VELOCITY]]
    for duration, kick, level, slope in segments:
        forces[VELOCITY, whole : whole + len(kick)] += kick
        forces[FORCE] = forces[SLOPE] = 0.0
        forces[FORCE, whole : whole + len(level)] = level
        forces[SLOPE, whole : whole + len(slope)] = slope
        flow = _flow(damping, stiffness, duration)
        motion, forces = flow @ motion, flow @ forces
    rows = [POSITION, VELOCITY, TRAVEL]
    return DeviceStep(motion[rows], forces[rows])


def _flow(damping: float, stiffness: float, duration: float) -> Floats:
    """exp(A t) of the mass with friction and spring, under a force that grows evenly."""
    rate = np.zeros((5, 5))
    rate[POSITION, VELOCITY] = rate[VELOCITY, FORCE] = rate[TRAVEL, POSITION] = rate[FORCE, SLOPE] = 1.0
    rate[VELOCITY, VELOCITY] = -damping
    rate[VELOCITY, POSITION] = -stiffness
    halvings = math.ceil(math.log2(max(1.0, damping, stiffness))) + 2
    scaled = rate * (duration / 2.0**halvings)
    flow = np.eye(5)
    for n in reversed(range(1, TAYLOR_TERMS + 1)):
        flow = np.eye(5) + scaled @ flow / n
    return np.linalg.matrix_power(flow, 2**halvings)
