"""Exact motion of one device channel over one sample period: the real mass, moved by the hold.

Channels whose masses are a matrix M move together. In place of numbers they have matrices (C, C), in place of rows and
columns blocks, and forces are T² M^-1 f.

Lengths in metres, times in sample periods, forces as T²/m f. Everything is written as changes, so that slow motions
keep their digits. The method is the matrix exponential.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.holds import Piece
from hapsim.theory.arrays import Floats
from hapsim.theory.interface import SAMPLINGS, hold_segments, whole_and_fraction
from hapsim.theory.schemes import exactly

# Changes of position and velocity; integral of the change of position; the force and its slope; the initial values.
POSITION, VELOCITY, TRAVEL, FORCE, SLOPE, FIRST_POSITION, FIRST_VELOCITY = range(7)
SHORTEST = 1e-12  # sample periods
BEGIN = np.eye(2)


class DeviceStep(NamedTuple):
    """One sample period of a channel: ``motion`` (4, 2) multiplies the position and velocity before, ``forces`` (4,
    ages) the computed forces by their age in whole samples, newest first. The four rows: change of position, change of
    velocity, lead of the new position over its reading, velocity as read. Of coupled channels: (4, C, 2, C) and (4, C,
    ages, C)."""

    motion: Floats
    forces: Floats

    @property
    def moves(self) -> tuple[Floats, Floats]:
        """New position and velocity and their readings: (4, 2) and (4, ages)."""
        motion, forces = self.motion.copy(), self.forces.copy()
        motion[:2] += BEGIN
        motion[2], forces[2] = motion[0] - motion[2], forces[0] - forces[2]
        return motion, forces


@lru_cache(maxsize=64)
def device_step(damping: float, delay: float, hold: str, stiffness: float = 0.0, sampling: str = "ideal") -> DeviceStep:
    """Returns the step of a mass with normalised friction b0 T/m, own spring k0 T²/m and a delay in sample periods."""
    motion, forces = coupled_step(np.array([[damping]]), delay, hold, np.array([[stiffness]]), sampling)
    step = DeviceStep(motion[:, 0, :, 0], forces[:, 0, :, 0])
    for shared in step:
        shared.flags.writeable = False
    return step


def coupled_step(damping: Floats, delay: float, hold: str, stiffness: Floats, sampling: str) -> DeviceStep:
    """Returns the step of coupled channels with normalised friction T M^-1 b0 and own springs T² M^-1 k0, (C, C)."""
    whole, fraction = whole_and_fraction(delay)
    window = SAMPLINGS[sampling].window
    segments = hold_segments(hold, fraction)
    before, after = split(segments, 1.0 - window)
    opened = _moved(_at_begin(ages_of(segments), len(damping)), before, damping, stiffness)
    opened[TRAVEL] = 0.0
    moved = _moved(opened, after, damping, stiffness)
    rows = np.stack([*moved[:2], np.zeros_like(moved[0]), moved[VELOCITY] + moved[FIRST_VELOCITY]])
    if window > 0.0:
        rows[2] = moved[POSITION] - moved[TRAVEL] / window
        rows[3] = (moved[POSITION] - opened[POSITION]) / window
    late = np.zeros((4, len(damping), whole, len(damping)))
    return DeviceStep(rows[:, :, :2], np.concatenate([late, rows[:, :, 2:]], axis=2))


def split(segments: list[Piece], at: float) -> tuple[list[Piece], list[Piece]]:
    """Splits the segments at ``at`` sample periods; a segment that spans this instant is divided."""
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
    """Number of forces that act in these segments of a hold."""
    return max((len(weights) for _, *acting in segments for weights in acting), default=0)


def through(segments: list[Piece], damping: float, stiffness: float, ages: int) -> tuple[Floats, Floats]:
    """Changes of position and velocity over segments of a hold, from the position and velocity before, (2, 2), and from
    the forces, (2, ages)."""
    moved = _moved(_at_begin(ages, 1), segments, np.array([[damping]]), np.array([[stiffness]]))
    return moved[:2, 0, :2, 0], moved[:2, 0, 2:, 0]


def _at_begin(ages: int, channels: int) -> Floats:
    begin = np.zeros((7, channels, 2 + ages, channels))
    begin[FIRST_POSITION, :, 0] = begin[FIRST_VELOCITY, :, 1] = np.eye(channels)
    return begin


def _moved(begin: Floats, segments: list[Piece], damping: Floats, stiffness: Floats) -> Floats:
    """Returns the state of the masses, with friction and springs (C, C), after segments of a hold, each with a linear
    force. ``begin``: (7, C, 2 + ages, C)."""
    one, size = np.eye(len(damping)), 7 * len(damping)
    rate = np.zeros((7, len(damping), 7, len(damping)))
    rate[POSITION, :, VELOCITY] = rate[POSITION, :, FIRST_VELOCITY] = rate[VELOCITY, :, FORCE] = one
    rate[TRAVEL, :, POSITION] = rate[FORCE, :, SLOPE] = one
    rate[VELOCITY, :, VELOCITY] = rate[VELOCITY, :, FIRST_VELOCITY] = -damping
    rate[VELOCITY, :, POSITION] = rate[VELOCITY, :, FIRST_POSITION] = -stiffness
    moved = begin.copy()
    for duration, *weights in segments:
        kick, level, slope = (np.array(of_ages)[:, None] * one[:, None] for of_ages in weights)
        moved[VELOCITY, :, 2 : 2 + kick.shape[1]] += kick
        moved[[FORCE, SLOPE]] = 0.0
        moved[FORCE, :, 2 : 2 + level.shape[1]] = level
        moved[SLOPE, :, 2 : 2 + slope.shape[1]] = slope
        flat = moved.reshape(size, -1)
        with np.errstate(over="ignore", invalid="ignore"):  # infinite for an oscillation much faster than the period
            flat += exactly(duration * rate.reshape(size, size), flat, 0.0 * flat)
    return moved
