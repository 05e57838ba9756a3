"""The state that the device's mass will have when a force that is computed now begins to act on it, and the steady push
of the hand that holds it.

Florens et al. (§6.3) ask for it: "additional speed and acceleration sensor may be used to compensate the effect of
delay". With the mass known, no sensor is needed. An observer keeps position, velocity and push; from sample to sample
the forces that acted lead them on, and what is read corrects them; the forces that are on their way lead them to the
instant (n + delay) T. Of a mass that is the declared one, under no push, the state is exact from the second sample on,
whatever it was before; a push that changes is found as the observer's poles say.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.holds import Piece
from hapsim.theory.arrays import Floats
from hapsim.theory.device_step import DeviceStep, ages_of, device_step, split, through
from hapsim.theory.hand import Configuration
from hapsim.theory.hand.lone_hand import lone_hand
from hapsim.theory.interface import SAMPLINGS, damper_named, hold_segments, whole_and_fraction
from hapsim.theory.network.network import BACKWARD

READING, MEAN_VELOCITY = 2, 3  # rows of a DeviceStep
STATES = 3  # position, velocity, push
SLOWEST = 0.5
"""The observer's double pole: nearer to 0 it costs noise, nearer to 1 it knows a new push later."""


class StatePredictor(NamedTuple):
    """An observer of position (m), velocity (m/s) and push (N), and what it expects.

    The columns (3 + lags) of ``step``, ``reading`` and ``ahead`` are the state's, and those of the forces that were
    computed before the next sample: f[n-1], f[n-2], ... for sample n.
    """

    step: Floats
    """(2, 3 + lags): position and velocity at sample n before its reading, from the state at sample n - 1."""
    reading: Floats
    """(R, 3 + lags): what will be read then: a position and, where the device ``senses`` it, a velocity."""
    gains: Floats
    """(3, R): how a reading that is other than expected corrects the state."""
    first: Floats
    """(2, R): the same of position and velocity, of the second sample that is read: no push is known yet."""
    ahead: Floats
    """(2, 3 + lags): position and velocity at (n + delay) T, just before the force that answers sample n."""
    differences: bool = False
    """Whether the damper that it is for takes the last two positions ahead, in place of the velocity ahead."""

    @property
    def lags(self) -> int:
        """How many past forces it knows."""
        return int(self.ahead.shape[1]) - STATES

    @property
    def senses(self) -> bool:
        """Whether it reads velocities."""
        return len(self.reading) == 2

    def at_rest(self) -> Floats:
        """(3, 2): position and velocity ahead, and push, of one metre that is read and does not change, and of what
        each N of a force that does not change brings beside it."""
        rows = np.vstack([self.step, self.reading[:1]])
        balance = np.vstack([np.eye(2, STATES), np.zeros(STATES)]) - rows[:, :STATES] * [[1.0], [1.0], [-1.0]]
        force = rows[:, STATES:].sum(axis=1) * [1.0, 1.0, -1.0]
        state = np.linalg.solve(balance, np.stack([[0.0, 0.0, 1.0], force], axis=-1))
        ahead = self.ahead[:, :STATES] @ state
        ahead[:, 1] += self.ahead[:, STATES:].sum(axis=1)
        return np.vstack([ahead, state[2]])

    def for_compliance(self, compliance: float) -> StatePredictor:
        """The same, where the position ahead moves this number of metres per newton of the push."""
        ahead = self.ahead.copy()
        ahead[0, 2] += compliance
        return self._replace(ahead=ahead)


def state_predictor(model: Configuration, senses: bool = False, pole: float = SLOWEST) -> StatePredictor:
    """The predictor of the mass that the model has, behind its hold, sampling and delay.

    ``senses``: the device sends velocities, read as ``DamperModel`` says of the sensed damper. ``pole``: of the
    observer, in the z-plane, twice where only positions are read; its others are zeros.
    """
    own = model.friction / model.damping_unit, model.stiffness / model.stiffness_unit
    step = device_step(own[0], model.delay, model.hold, own[1], model.sampling)
    pushed = device_step(own[0], 0.0, "zoh", own[1], model.sampling).moves[1].sum(axis=1)
    read = [READING, MEAN_VELOCITY] if senses else [READING]
    lags = step.forces.shape[1]
    every = np.zeros((4, STATES + lags))
    every[:, :2], every[:, 2], every[:, STATES:] = step.moves[0], pushed, step.moves[1]
    moves = np.vstack([every[:2, :STATES], [0.0, 0.0, 1.0]])
    gains = (_of_velocities if senses else _of_positions)(moves, every[read, :STATES], pole)
    # What is unknown of a free motion at the first sample.
    before = np.array([SAMPLINGS[model.sampling].lag, 1.0])
    first = gains[:2] if senses else (moves[:2, :2] @ before / (every[READING, :2] @ before))[:, None]
    return _in_si(model, every[:2], every[read], gains, first, _ahead(model, own, step, pushed))


def as_read(model: Configuration) -> StatePredictor:
    """What a link without a predictor answers, as one: the position as it is read, and the velocity that the damper
    makes of positions. In place of the push it keeps the last difference of two positions."""
    damper = damper_named(model.damper, model.cutoff, model.rate)
    if damper.senses:
        moves, gains = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]), np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
        return StatePredictor(moves, moves, gains, gains[:2], np.eye(2, STATES))
    newest, _, oldest = (*damper.of_positions, 0.0)[:3]
    decay = damper.of_velocities[0] if damper.of_velocities else 0.0
    moves = np.array([[1.0, 0.0, 1.0], [0.0, decay, model.rate * (newest - oldest)]])
    gains = np.array([[1.0], [model.rate * newest], [1.0]])
    read = StatePredictor(moves, moves[:1], gains, gains[:2], np.eye(2, STATES))
    return read.for_compliance(-model.spring_lag)


def _ahead(model: Configuration, own: tuple[float, float], step: DeviceStep, pushed: Floats) -> Floats:
    whole, fraction = whole_and_fraction(model.delay)
    state = np.zeros((2, STATES + step.forces.shape[1]))
    state[0, 0] = state[1, 1] = 1.0
    forces = state[:, STATES:]
    for later in range(1, whole + 1):
        # In the period that begins later - 1 samples after sample n, forces from n on do not act yet.
        state += step.motion[:2] @ state
        state[:, 2] += pushed[:2]
        acting = step.forces[:2, later:]  # age `later` is f[n-1] there
        forces[:, : acting.shape[1]] += acting
    segments, _ = split(hold_segments(model.hold, fraction), fraction)
    motion, made = through(segments, *own, max(ages_of(segments), 1))
    state += motion @ state
    state[:, 2] += through([Piece(fraction, level=(1.0,))], *own, 1)[1][:, 0] if segments else 0.0
    older = made[:, 1:]  # age 0 is f[n], before which these segments end
    forces[:, : older.shape[1]] += older
    return state


def _of_positions(moves: Floats, read: Floats, pole: float) -> Floats:
    """(3, 1): with which ``moves - gains read`` has its poles at (pole, pole, 0); Ackermann's formula."""
    seen = np.vstack([read, read @ moves, read @ moves @ moves])
    wanted = (moves - pole * np.eye(STATES)) @ (moves - pole * np.eye(STATES)) @ moves
    return np.asarray(wanted @ np.linalg.inv(seen)[:, -1:])


def _of_velocities(moves: Floats, read: Floats, pole: float) -> Floats:
    """(3, 2): position and velocity as they are read, given the push; of what that leaves unexplained the push takes
    the share 1 - pole."""
    at_once = moves[:2, :2] @ np.linalg.inv(read[:, :2])
    left = read[:, :2] @ (moves[:2, 2] - at_once @ read[:, 2]) + read[:, 2]
    return np.vstack([at_once, (1.0 - pole) * left / (left @ left)])


def _in_si(
    model: Configuration, step: Floats, reading: Floats, gains: Floats, first: Floats, ahead: Floats
) -> StatePredictor:
    """From metres, sample periods and T²/m f."""
    state = np.array([1.0, model.rate, model.stiffness_unit])  # one m, m a period and m of T²/m f
    columns = np.concatenate([state, np.full(step.shape[1] - STATES, model.stiffness_unit)])
    read = state[: len(reading)]
    return StatePredictor(
        step=state[:2, None] * step / columns,
        reading=read[:, None] * reading / columns,
        gains=state[:, None] * gains / read,
        first=state[:2, None] * first / read,
        ahead=state[:2, None] * ahead / columns,
    )


def forces_in_second_difference(model: Configuration) -> tuple[Floats, int]:
    """(weights, first): y[n] - 2 y[n-1] + y[n-2] of the readings of a mass that nothing but the hold pushes is T²/m
    times the sum of weights[i] f[n - first - i]; their sum is 1."""
    hand = lone_hand(0.0, 0.0, model.delay, model.hold, model.sampling, BACKWARD, 0.0)
    of_forces = hand.polynomials[1]
    acting = np.flatnonzero(of_forces)
    return of_forces[acting[0] : acting[-1] + 1], int(acting[0])
