"""One device channel over one sample period, exactly: the real mass, moved by the hold from sample to sample.

Lengths in metres, times in sample periods, forces as T²/m f. By the matrix exponential, so that nothing is
shared with the transforms of ``sampled_plant.py``, against which it is a check.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.holds import Piece
from hapsim.theory.arrays import Floats
from hapsim.theory.interface import SAMPLINGS, hold_segments, whole_and_fraction

POSITION, VELOCITY, TRAVEL, FORCE, SLOPE = range(5)  # TRAVEL: the position's integral
TAYLOR_TERMS = 18  # for a norm of a half: beyond rounding
SHORTEST = 1e-12  # sample periods


class DeviceStep(NamedTuple):
    """What one sample period makes of a channel.

    ``motion`` (4, 2): new position and velocity, and the readings of them, from the position and velocity before.
    ``forces`` (4, ages): the same from the computed forces, by their age in whole samples, the newest first.
    ``window``: sample periods over which the reading is the mean.
    """

    motion: Floats
    forces: Floats
    window: float


@lru_cache(maxsize=64)
def device_step(damping: float, delay: float, hold: str, stiffness: float = 0.0, sampling: str = "ideal") -> DeviceStep:
    """The step of a mass with the normalised friction b0 T/m and own spring k0 T²/m, and a delay in sample periods."""
    whole, fraction = whole_and_fraction(delay)
    window = SAMPLINGS[sampling].window
    segments = hold_segments(hold, fraction)
    ages = ages_of(segments)
    parts = [through(part, damping, stiffness, ages) for part in split(segments, 1.0 - window)]
    (opened, opened_by), (motion, forces) = parts
    motion, forces = motion @ opened[:2], forces + motion @ opened_by[:2]
    both, opens = np.hstack([motion, forces]), np.hstack([opened, opened_by])
    read = both[:2]
    if window > 0.0:
        read = np.stack([both[TRAVEL], both[POSITION] - opens[POSITION]]) / window
    rows = np.vstack([both[:2], read])
    step = DeviceStep(rows[:, :2], np.hstack([np.zeros((4, whole)), rows[:, 2:]]), window)
    for shared in step[:2]:
        shared.flags.writeable = False
    return step


def split(segments: list[Piece], at: float) -> tuple[list[Piece], list[Piece]]:
    """The segments before ``at`` sample periods and those from there on; one that spans it is cut in two."""
    before, after, begin = [], [], 0.0
    for piece in segments:
        first = at - begin
        begin += piece.duration
        if first >= piece.duration - SHORTEST:
            before.append(piece)
        elif first <= SHORTEST:
            after.append(piece)
        else:
            level = np.zeros(max(len(piece.level), len(piece.slope)))
            level[: len(piece.level)] = piece.level
            level[: len(piece.slope)] += first * np.array(piece.slope)
            before.append(piece._replace(duration=first))
            after.append(Piece(piece.duration - first, level=tuple(level.tolist()), slope=piece.slope))
    return before, after


def ages_of(segments: list[Piece]) -> int:
    """How many forces act in these segments of a hold."""
    return max((len(weights) for _, *acting in segments for weights in acting), default=0)


def through(segments: list[Piece], damping: float, stiffness: float, ages: int) -> tuple[Floats, Floats]:
    """(3, 2) and (3, ages): position, velocity and travel after some segments of a hold, from the position and velocity
    before them and from the forces."""
    motion, forces = np.eye(5, 2), np.zeros((5, ages))
    for duration, kick, level, slope in segments:
        forces[VELOCITY, : len(kick)] += kick
        forces[[FORCE, SLOPE]] = 0.0
        forces[FORCE, : len(level)] = level
        forces[SLOPE, : len(slope)] = slope
        flow = _flow(damping, stiffness, duration)
        motion, forces = flow @ motion, flow @ forces
    return motion[:3], forces[:3]


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
    with np.errstate(over="ignore", invalid="ignore"):  # infinite for a swing much faster than the period
        return np.linalg.matrix_power(flow, 2**halvings)
