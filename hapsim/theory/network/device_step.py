"""One device channel over one sample period, exactly: the real mass, moved by the hold from sample to sample.

Lengths in metres, times in sample periods, forces as T²/m f. By the matrix exponential, so that nothing is
shared with the transforms of ``sampled_plant.py``, against which it is a check.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.holds import Piece
from hapsim.theory.arrays import Floats
from hapsim.theory.interface import SAMPLINGS, hold_segments, whole_and_fraction

POSITION, VELOCITY, FORCE, TRAVEL, SLOPE = range(5)  # TRAVEL: the position's integral over the period
TAYLOR_TERMS = 18  # for a norm of a half: beyond rounding


class DeviceStep(NamedTuple):
    """What one sample period makes of a channel.

    ``motion`` (4, 2): new position and velocity, and what is read of them, from the position and velocity before.
    ``forces`` (4, ages): the same from the computed forces, by their age in whole samples, the newest first.
    ``window``: sample periods over which the reading is the mean.
    """

    motion: Floats
    forces: Floats
    window: float


def device_step(damping: float, delay: float, hold: str, stiffness: float = 0.0, sampling: str = "ideal") -> DeviceStep:
    """The step of a mass with the normalised friction b0 T/m and own spring k0 T²/m, and a delay in sample periods."""
    whole, fraction = whole_and_fraction(delay)
    window = SAMPLINGS[sampling].window
    segments = _opened(hold_segments(hold, fraction), 1.0 - window)
    ages = max(len(weights) for _, (_, *made) in segments for weights in made)
    forces = np.zeros((5, whole + ages))
    motion = np.eye(5)[:, [POSITION, VELOCITY]]
    begin = [motion[POSITION], forces[POSITION]]
    for opens, (duration, kick, level, slope) in segments:
        if opens:
            begin = [motion[POSITION].copy(), forces[POSITION].copy()]
            motion[TRAVEL] = forces[TRAVEL] = 0.0
        forces[VELOCITY, whole : whole + len(kick)] += kick
        forces[FORCE] = forces[SLOPE] = 0.0
        forces[FORCE, whole : whole + len(level)] = level
        forces[SLOPE, whole : whole + len(slope)] = slope
        flow = _flow(damping, stiffness, duration)
        motion, forces = flow @ motion, flow @ forces
    read = [
        [made[TRAVEL] / window, (made[POSITION] - before) / window] if window > 0.0 else made[[POSITION, VELOCITY]]
        for made, before in zip((motion, forces), begin, strict=True)
    ]
    rows = [POSITION, VELOCITY]
    return DeviceStep(np.vstack([motion[rows], read[0]]), np.vstack([forces[rows], read[1]]), window)


def through(segments: list[Piece], damping: float, stiffness: float) -> tuple[Floats, Floats]:
    """(2, 2) and (2, ages): position and velocity after some segments of a hold, from those before and the forces."""
    ages = max((len(weights) for _, *made in segments for weights in made), default=0)
    motion, forces = np.eye(5)[:, [POSITION, VELOCITY]], np.zeros((5, ages))
    for duration, kick, level, slope in segments:
        forces[VELOCITY, : len(kick)] += kick
        forces[FORCE] = forces[SLOPE] = 0.0
        forces[FORCE, : len(level)] = level
        forces[SLOPE, : len(slope)] = slope
        flow = _flow(damping, stiffness, duration)
        motion, forces = flow @ motion, flow @ forces
    return motion[:2], forces[:2]


def _opened(segments: list[Piece], at: float) -> list[tuple[bool, Piece]]:
    """The segments, one of which begins ``at`` sample periods into the period: where the window of the reading opens,
    which is said beside it."""
    begin, found = 0.0, []
    for segment in segments:
        first = at - begin
        if 0.0 < first < segment.duration:
            level = np.zeros(max(len(segment.level), len(segment.slope)))
            level[: len(segment.level)] = segment.level
            level[: len(segment.slope)] += first * np.array(segment.slope)
            rest = Piece(segment.duration - first, level=tuple(level.tolist()), slope=segment.slope)
            found += [(False, segment._replace(duration=first)), (True, rest)]
        else:
            found.append((first <= 0.0 and not any(opens for opens, _ in found), segment))
        begin += segment.duration
    return found


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
    with np.errstate(over="ignore", invalid="ignore"):  # beyond all numbers where a period is endless beside the swing
        return np.linalg.matrix_power(flow, 2**halvings)
