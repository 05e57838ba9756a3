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

POSITION, VELOCITY, FORCE, TRAVEL = range(4)  # TRAVEL: the position's integral over the period
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
    ages = [age for segment in segments for age in (segment.kick, segment.constant) if age is not None]
    forces = np.zeros((4, 1 + whole + max(ages)))
    motion = np.eye(4)[:, [POSITION, VELOCITY]]
    for segment in segments:
        if segment.kick is not None:
            forces[VELOCITY, whole + segment.kick] += 1.0
        forces[FORCE] = 0.0
        if segment.constant is not None:
            forces[FORCE, whole + segment.constant] = 1.0
        flow = _flow(damping, stiffness, segment.duration)
        motion, forces = flow @ motion, flow @ forces
    rows = [POSITION, VELOCITY, TRAVEL]
    return DeviceStep(motion[rows], forces[rows])


def _flow(damping: float, stiffness: float, duration: float) -> Floats:
    """exp(A t) of the mass with friction and spring, under a constant force."""
    rate = np.zeros((4, 4))
    rate[POSITION, VELOCITY] = rate[VELOCITY, FORCE] = rate[TRAVEL, POSITION] = 1.0
    rate[VELOCITY, VELOCITY] = -damping
    rate[VELOCITY, POSITION] = -stiffness
    halvings = math.ceil(math.log2(max(1.0, damping, stiffness))) + 2
    scaled = rate * (duration / 2.0**halvings)
    flow = np.eye(4)
    for n in reversed(range(1, TAYLOR_TERMS + 1)):
        flow = np.eye(4) + scaled @ flow / n
    return np.linalg.matrix_power(flow, 2**halvings)
