"""Exact motion of one device channel over one sample period: the real mass, or another plant, moved by the hold.

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
from hapsim.theory.plant import RIGID, Drive, Plant, masses
from hapsim.theory.schemes import exactly

SHORTEST = 1e-12  # sample periods
BEGIN = np.eye(2)


class DeviceStep(NamedTuple):
    """One sample period of a channel: ``motion`` (4 + I, 2 + I) multiplies the position, the velocity and the I inner
    states before, ``forces`` (4 + I, ages) the computed forces by their age in whole samples, newest first. The rows:
    change of position, change of velocity, lead of the new position over its reading, velocity as read, changes of the
    inner states. Of coupled channels: (4, C, 2, C) and (4, C, ages, C)."""

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
def device_step(
    damping: float, delay: float, hold: str, stiffness: float = 0.0, sampling: str = "ideal", drive: Drive = RIGID
) -> DeviceStep:
    """Returns the step of a mass with normalised friction b0 T/m, own spring k0 T²/m, a delay in sample periods and a
    normalised drive."""
    rigid = masses(np.array([[damping]]), np.array([[stiffness]]))
    step = _step(drive.plant(damping, stiffness) if drive.inner else rigid, delay, hold, sampling)
    for shared in step:
        shared.flags.writeable = False
    return step


def coupled_step(damping: Floats, delay: float, hold: str, stiffness: Floats, sampling: str) -> DeviceStep:
    """Returns the step of coupled channels with normalised friction T M^-1 b0 and own springs T² M^-1 k0, (C, C)."""
    motion, forces = _step(masses(damping, stiffness), delay, hold, sampling)
    count = len(damping)
    return DeviceStep(motion.reshape(4, count, 2, count), forces.reshape(4, count, -1, count))


def _step(plant: Plant, delay: float, hold: str, sampling: str) -> DeviceStep:
    """Returns the step of a plant (n, C): (4 C + I, n) and (4 C + I, ages C)."""
    size, channels = plant.force.shape
    whole, fraction = whole_and_fraction(delay)
    window = SAMPLINGS[sampling].window
    segments = hold_segments(hold, fraction)
    before, after = split(segments, 1.0 - window)
    opened = _moved(_at_begin(ages_of(segments), plant), before, plant)
    opened[size : size + channels] = 0.0
    moved = _moved(opened, after, plant)
    position, velocity, travel = moved[:channels], moved[channels : 2 * channels], moved[size : size + channels]
    lead, read = np.zeros_like(position), velocity + moved[channels - size : 2 * channels - size or None]
    if window > 0.0:
        lead, read = position - travel / window, (position - opened[:channels]) / window
    rows = np.vstack([position, velocity, lead, read, moved[2 * channels : size]])
    late = np.zeros((len(rows), whole * channels))
    return DeviceStep(rows[:, :size], np.hstack([late, rows[:, size:]]))


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
    plant = masses(np.array([[damping]]), np.array([[stiffness]]))
    moved = _moved(_at_begin(ages, plant), segments, plant)
    return moved[:2, :2], moved[:2, 2:]


def motions_within(plant: Plant, delay: float, hold: str, count: int) -> list[Floats]:
    """Changes of a plant's state (n,) from the sample's begin up to each of ``count`` equal parts of it, from the state
    then and the computed forces by their age, (n, n + ages)."""
    whole, fraction = whole_and_fraction(delay)
    segments, (size, channels) = hold_segments(hold, fraction), plant.force.shape
    begin, late = _at_begin(ages_of(segments), plant), np.zeros((size, whole * channels))
    each = (_moved(begin, split(segments, (i + 1) / count)[0], plant)[:size] for i in range(count))
    return [np.hstack([moved[:, :size], late, moved[:, size:]]) for moved in each]


def _at_begin(ages: int, plant: Plant) -> Floats:
    size, channels = plant.force.shape
    return np.eye(2 * size + 3 * channels, size + ages * channels, -size - 3 * channels)


def _moved(begin: Floats, segments: list[Piece], plant: Plant) -> Floats:
    """Returns the state of a plant (n, C) after segments of a hold, each with a linear force, (2 n + 3 C, n + ages C):
    change of its state; integral of the change of the position; the force and its slope; the initial state."""
    size, channels = plant.force.shape
    force, slope = (slice(size + i * channels, size + (i + 1) * channels) for i in (1, 2))
    one, rate = np.eye(channels), np.zeros((len(begin), len(begin)))
    rate[:size, :size] = rate[:size, -size:] = plant.rates
    rate[:size, force] = plant.force
    rate[size : force.start, :channels] = rate[force, slope] = one
    moved = begin.copy()
    for duration, *weights in segments:
        kick, level, inclined = (np.kron(np.array(of_ages), one) for of_ages in weights)
        moved[:size, size : size + kick.shape[1]] += plant.force @ kick
        moved[force.start : slope.stop] = 0.0
        moved[force, size : size + level.shape[1]] = level
        moved[slope, size : size + inclined.shape[1]] = inclined
        with np.errstate(over="ignore", invalid="ignore"):  # infinite for an oscillation much faster than the period
            moved += exactly(duration * rate, moved, 0.0 * moved)
    return moved
