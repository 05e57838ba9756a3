"""The state that the device's mass will have when a force that is computed now begins to act on it.

Florens et al. (§6.3) ask for it: "additional speed and acceleration sensor may be used to compensate the effect of
delay". With the mass known, no sensor is needed: two readings and the forces that are on their way tell position and
velocity at the sample, and the same forces lead them on to the instant (n + delay) T. Nothing is filtered: of a mass
that is the declared one the state is exact after two samples, whatever it was before.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats
from hapsim.theory.hand import Configuration
from hapsim.theory.hand.plant import sampled_plant
from hapsim.theory.interface import HOLDS, HoldSegment, whole_and_fraction
from hapsim.theory.network.device_step import POSITION, DeviceStep, device_step, through

READING, MEAN_VELOCITY = 2, 3  # rows of a DeviceStep


class StatePredictor(NamedTuple):
    """Position (m) and velocity (m/s) at (n + delay) T, just before the force that answers sample n.

    ``readings`` (2, 2): from the position that was read at sample n, in m, and from the one of sample n - 1, in m, or,
    where the device ``senses`` it, the velocity of sample n, in m/s.
    ``forces`` (2, lags): from the forces f[n-1], f[n-2], ..., in N.
    """

    readings: Floats
    forces: Floats
    senses: bool = False

    @property
    def lags(self) -> int:
        """How many past forces it knows."""
        return int(self.forces.shape[1])


def state_predictor(model: Configuration, senses: bool = False) -> StatePredictor:
    """The predictor of the mass that the model has, behind its hold, sampling and delay.

    ``senses``: the device sends velocities, read as ``DamperModel`` says of the sensed damper.
    """
    own = model.friction / model.damping_unit, model.stiffness / model.stiffness_unit
    step = device_step(own[0], model.delay, model.hold, own[1], model.sampling)
    readings, forces = _state_at_sample(step, senses)
    whole, fraction = whole_and_fraction(model.delay)
    for ahead in range(1, whole + 1):
        # In the period that begins ahead - 1 samples after sample n, forces from n on do not act yet.
        readings = step.motion[:2] @ readings
        forces = step.motion[:2] @ forces
        acting = step.forces[:2, ahead:]  # age `ahead` is f[n-1] there
        forces[:, : acting.shape[1]] += acting
    motion, made = through(_until(fraction, HOLDS[model.hold].segments(fraction)), *own)
    readings, forces = motion @ readings, motion @ forces
    older = made[:, 1:]  # age 0 is f[n], which the last of these periods' parts ends before
    forces[:, : older.shape[1]] += older
    return _in_si(model, readings, forces, senses)


def _state_at_sample(step: DeviceStep, senses: bool) -> tuple[Floats, Floats]:
    """(2, 2) and (2, lags): position and velocity at sample n, of readings and past forces; in normalised units.

    What is read is a line in the state some samples before and the forces since: as many of these lines as the state
    has numbers are solved for it.
    """
    steps = 1 if senses or step.window == 0.0 else 2  # the reading of sample n - 1 looks back a period further
    lags = step.forces.shape[1] + steps - 1
    motion, forces = np.eye(2), np.zeros((2, lags))
    read, read_forces = np.zeros((2, 2)), np.zeros((2, lags))
    if steps == 1 and not senses:
        read[1] = motion[POSITION]  # at sample n - 1, from where the steps begin
    for later in range(1, steps + 1):
        age = steps - later  # f[n-1-age] is the newest that can act in this period
        made = step.motion @ motion
        made_by_force = step.motion @ forces
        made_by_force[:, age : age + step.forces.shape[1]] += step.forces
        row = 0 if later == steps else 1
        read[row], read_forces[row] = made[READING], made_by_force[READING]
        if senses:
            read[1], read_forces[1] = made[MEAN_VELOCITY], made_by_force[MEAN_VELOCITY]
        motion, forces = made[:2], made_by_force[:2]
    back = np.linalg.inv(read)
    return motion @ back, forces - motion @ back @ read_forces


def _until(fraction: float, segments: list[HoldSegment]) -> list[HoldSegment]:
    """The segments of a hold before a new force comes, ``fraction`` of a sample period into it."""
    before: list[HoldSegment] = []
    while segments and sum(segment.duration for segment in before) < fraction:
        before.append(segments.pop(0))
    return before


def _in_si(model: Configuration, readings: Floats, forces: Floats, senses: bool) -> StatePredictor:
    """From metres per sample period and T²/m f."""
    out = np.array([[1.0], [model.rate]])
    second = model.period if senses else 1.0
    return StatePredictor(out * readings * [1.0, second], out * forces / model.stiffness_unit, senses)


def forces_in_second_difference(model: Configuration) -> tuple[Floats, int]:
    """(weights, first): y[n] - 2 y[n-1] + y[n-2] of the readings of a mass that nothing but the hold pushes is T²/m
    times the sum of weights[i] f[n - first - i]; their sum is 1."""
    plant = sampled_plant(0.0, 0.0, model.delay, model.hold, model.sampling)
    return plant.numerator, plant.lead + 3 - plant.numerator.size
