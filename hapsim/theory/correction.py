"""Correction by prediction: an observer predicts the state in which the mass will receive the force.

Florens et al. (§6.3) propose sensors: "additional speed and acceleration sensor may be used to compensate the effect of
delay". With a known mass, no sensor is needed. An observer holds position, velocity and the steady push of the hand. At
each sample the forces that acted advance them, and the reading corrects them. The forces that are still delayed then
advance them to the instant (n + delay) T. For a mass that equals the declared one, under no push, the state is exact
from the second sample on, whatever it was before. A change of the push is found at the speed of the observer's poles.
The predictor may assume another mass than the real one: `PredictedLoop` computes the resulting errors.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.holds import Piece
from hapsim.theory.arrays import Complexes, Floats, sort_by_modulus
from hapsim.theory.device_step import DeviceStep, ages_of, device_step, split, through
from hapsim.theory.hand import Configuration
from hapsim.theory.hand.lone_hand import lone_hand
from hapsim.theory.hand.pole_pair import oscillator_of_quadratic
from hapsim.theory.hand.poles import pair_of_poles
from hapsim.theory.interface import (
    SAMPLINGS,
    acting_at_sample,
    damper_named,
    delay_and_hold,
    hold_segments,
    whole_and_fraction,
)
from hapsim.theory.network.network import BACKWARD

READING, MEAN_VELOCITY = 2, 3  # rows of a DeviceStep
STATES = 3  # position, velocity, push
SLOWEST = 0.5
"""Double pole of the observer: nearer to 0 it has more noise, nearer to 1 it follows a new push more slowly."""


class StatePredictor(NamedTuple):
    """Observer of position (m), velocity (m/s) and push (N), with its predictions. The columns (3 + lags) of ``step``,
    ``reading`` and ``ahead`` are the state, and the forces that were computed before the next sample: f[n-1], f[n-2],
    ... for sample n."""

    step: Floats
    """Position and velocity at sample n before its reading, (2, 3 + lags), from the state at sample n - 1."""
    reading: Floats
    """Expected readings, (R, 3 + lags): a position and, where the device ``senses`` it, a velocity."""
    gains: Floats
    """Corrections of the state, (3, R), for each unit of difference between a reading and the expected one."""
    first: Floats
    """Corrections of position and velocity at the second sample, (2, R): no push is known yet."""
    ahead: Floats
    """Position and velocity at (n + delay) T, (2, 3 + lags), just before the force of sample n acts."""
    differences: bool = False
    """True if the damper uses the last two positions ahead instead of the velocity ahead."""

    @property
    def lags(self) -> int:
        """Number of past forces that the predictor uses."""
        return int(self.ahead.shape[1]) - STATES

    @property
    def senses(self) -> bool:
        """True if the predictor reads velocities."""
        return len(self.reading) == 2

    def at_rest(self) -> Floats:
        """Position and velocity ahead, and push, (3, 2), at rest: for a constant reading of one metre, and the
        additions for each N of a constant force."""
        rows = np.vstack([self.step, self.reading[:1]])
        balance = np.vstack([np.eye(2, STATES), np.zeros(STATES)]) - rows[:, :STATES] * [[1.0], [1.0], [-1.0]]
        force = rows[:, STATES:].sum(axis=1) * [1.0, 1.0, -1.0]
        state = np.linalg.solve(balance, np.stack([[0.0, 0.0, 1.0], force], axis=-1))
        ahead = self.ahead[:, :STATES] @ state
        ahead[:, 1] += self.ahead[:, STATES:].sum(axis=1)
        return np.vstack([ahead, state[2]])

    def for_compliance(self, compliance: float) -> StatePredictor:
        """Returns this predictor with the position ahead moved by ``compliance`` metres per newton of push."""
        ahead = self.ahead.copy()
        ahead[0, 2] += compliance
        return self._replace(ahead=ahead)


def state_predictor(model: Configuration, senses: bool = False, pole: float = SLOWEST) -> StatePredictor:
    """Returns the predictor of the model's mass, with its hold, sampling and delay. ``senses``: the device sends
    velocities, read as by the sensed damper of ``DamperModel``. ``pole``: of the observer, in the z-plane, double where
    only positions are read; the other poles are zero."""
    own = model.friction / model.damping_unit, model.stiffness / model.stiffness_unit
    step = device_step(own[0], model.delay, model.hold, own[1], model.sampling)
    pushed = device_step(own[0], 0.0, "zoh", own[1], model.sampling).moves[1].sum(axis=1)
    read = [READING, MEAN_VELOCITY] if senses else [READING]
    lags = step.forces.shape[1]
    every = np.zeros((4, STATES + lags))
    every[:, :2], every[:, 2], every[:, STATES:] = step.moves[0], pushed, step.moves[1]
    moves = np.vstack([every[:2, :STATES], [0.0, 0.0, 1.0]])
    gains = (_velocity_gains if senses else _position_gains)(moves, every[read, :STATES], pole)
    # Unknown part of a free motion at the first sample.
    before = np.array([SAMPLINGS[model.sampling].lag, 1.0])
    first = gains[:2] if senses else (moves[:2, :2] @ before / (every[READING, :2] @ before))[:, None]
    return _in_si(model, every[:2], every[read], gains, first, _ahead(model, own, step, pushed))


def plain_predictor(model: Configuration) -> StatePredictor:
    """Returns a link without a predictor in the form of one: the position as read, and the damper's velocity. In place
    of the push its state has the last difference of two positions."""
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
    older = made[:, 1:]  # age 0 is f[n]: it acts only after these segments
    forces[:, : older.shape[1]] += older
    return state


def _position_gains(moves: Floats, read: Floats, pole: float) -> Floats:
    """Gains (3, 1) that place the poles of ``moves - gains read`` at (pole, pole, 0), by Ackermann's formula."""
    seen = np.vstack([read, read @ moves, read @ moves @ moves])
    wanted = (moves - pole * np.eye(STATES)) @ (moves - pole * np.eye(STATES)) @ moves
    return np.asarray(wanted @ np.linalg.inv(seen)[:, -1:])


def _velocity_gains(moves: Floats, read: Floats, pole: float) -> Floats:
    """Gains (3, 2) that take position and velocity as read, and give the push 1 - pole of the remaining difference."""
    at_once = moves[:2, :2] @ np.linalg.inv(read[:, :2])
    left = read[:, :2] @ (moves[:2, 2] - at_once @ read[:, 2]) + read[:, 2]
    return np.vstack([at_once, (1.0 - pole) * left / (left @ left)])


def _in_si(
    model: Configuration, step: Floats, reading: Floats, gains: Floats, first: Floats, ahead: Floats
) -> StatePredictor:
    """Returns the predictor in SI units, from metres, sample periods and T²/m f."""
    state = np.array([1.0, model.rate, model.stiffness_unit])  # one m, m per period and m of T²/m f
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
    """Returns (weights, first) of the second difference of the readings of a mass that only the hold drives. y[n] - 2
    y[n-1] + y[n-2] is T²/m times the sum of weights[i] f[n - first - i]; the weights add up to 1."""
    hand = lone_hand(0.0, 0.0, model.delay, model.hold, model.sampling, BACKWARD, 0.0)
    of_forces = hand.polynomials[1]
    acting = np.flatnonzero(of_forces)
    return of_forces[acting[0] : acting[-1] + 1], int(acting[0])


def white_noise_gain(change: Floats, push: Floats, answer: Floats) -> float:
    """Force, N rms, of a stable loop per N rms of white noise in it. ``change`` (n, n), ``push`` (n,): of its state
    without the force; -``answer`` (n,): the force from the state."""
    closed = np.eye(len(change)) + change - np.outer(push, answer)
    return math.hypot(1.0, _noise(closed, push[:, None], answer))


def _noise(power: Floats, reads: Floats, answers: Floats) -> float:
    """Returns the rms of ``answers`` on a state that ``power`` moves, from white noise of 1 rms through ``reads``."""
    spread: Floats = reads @ reads.T
    while np.abs(power).max() > NEGLIGIBLE:  # twice as many samples of noise each time
        spread = spread + power @ spread @ power.T
        power = power @ power
    return float(np.sqrt(max(float(answers @ spread @ answers), 0.0)))


def forces_at_sample(model: Configuration, age: int) -> tuple[Floats, int]:
    """Returns (weights, first) of the force that acts at a sample: the sum of weights[i] f[n - first - i]. ``age`` 0:
    just after sample n; 1: just before it, as always if f[n] would act at once. No weights: an impulse is over."""
    weights = np.array(acting_at_sample(model.delay, model.hold, age))
    acting = np.flatnonzero(weights)
    return (weights[acting[0] : acting[-1] + 1], int(acting[0]) + 1) if acting.size else (weights[:0], 1)


NEGLIGIBLE = 1e-12  # of the oldest noise: its square is beyond rounding
MOVES = 2  # numbers of the plant's state: position and velocity


class PredictedLoop(NamedTuple):
    """Closed loop of a real ``plant`` and a ``predictor`` with the state (x, v, push): f = -K x - B v - g push. The
    share g is 0 without ``static``. With ``static`` (N/m) it makes a steady push meet this stiffness beside the
    device's own spring. If the predictor has the plant's mass, the loop has the two poles of this mass without a delay,
    those of the observer, and zeros."""

    plant: Configuration
    predictor: StatePredictor
    static: float | Floats | None = None

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """Poles (..., N) in the z-plane, by decreasing modulus; K in N/m, B in N·s/m; arrays broadcast."""
        moves, pushes, _ = self._open_loop()
        answers = self._feedback(K, B, len(moves))
        finite = np.isfinite(answers).all(axis=-1, keepdims=True)
        closed = moves - pushes[:, None] * np.where(finite, answers, 0.0)[..., None, :]
        return np.where(finite, sort_by_modulus(np.linalg.eigvals(closed).astype(complex)), np.nan)

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """Felt (k, b) in N/m and N·s/m, as ``Configuration.equivalent`` defines them."""
        with np.errstate(all="ignore"):
            p, q, dominant = pair_of_poles(self.poles(K, B))
            sigma, kappa = oscillator_of_quadratic(p, q)
            k, b = kappa * self.plant.stiffness_unit, sigma * self.plant.damping_unit
            return np.where(dominant, k, np.nan)[()], np.where(dominant, b, np.nan)[()]

    def spectral_radius(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Largest modulus of a pole."""
        return np.asarray(np.abs(self.poles(K, B)[..., 0]))[()]

    def impedance(self, K: float, B: float, frequency: ArrayLike) -> Complexes:
        """Rendered impedance, force over velocity in N·s/m, at frequencies (n,) in Hz, without the device's own. The
        predictor does not know the force of the hand, and no velocities are sent. NaN at 0 and from the Nyquist
        frequency on."""
        f = np.asarray(frequency, dtype=float)
        theta = 2.0 * np.pi * f * self.plant.period
        some = (theta > 0.0) & (theta < np.pi)
        through = delay_and_hold(theta[some], self.plant.delay, self.plant.hold, self.plant.sampling)
        found = np.full(f.shape, np.nan, dtype=complex)
        found[some] = self._stiffness_at(np.exp(1j * theta[some]), K, B) * through / (2j * np.pi * f[some])
        return found

    def steady_stiffness(self, K: float, B: float) -> float:
        """Stiffness that a steady push meets, N/m, at a velocity reading of 0, without the device's own spring."""
        return float(self._stiffness_at(np.ones(1, dtype=complex), K, B)[0].real)

    def noise_gain(self, K: float, B: float) -> float:
        """Noise gain of the closed loop: N rms of force per m rms of white noise on the positions, with an equal noise
        per sample period on the velocities; infinity if unstable."""
        if not self.spectral_radius(K, B) < 1.0:
            return math.inf
        moves, pushes, reads = self._open_loop()
        answers = self._feedback(K, B, len(moves))
        return _noise(moves - np.outer(pushes, answers), reads, answers) * self.plant.stiffness_unit

    def _stiffness_at(self, z: Complexes, K: float, B: float) -> Complexes:
        """Force over the position that is read, (n,) N/m, at z."""
        moves, pushes, reads = self._open_loop(moved=False)
        answers = self._feedback(K, B, len(moves))
        alone = moves - np.outer(pushes, answers)
        if not np.isfinite(alone).all():
            return np.full(z.shape, np.nan, dtype=complex)
        state = np.linalg.solve(z[:, None, None] * np.eye(len(alone)) - alone, z[:, None, None] * reads[:, :1])
        return np.asarray(state[..., 0] @ answers * self.plant.stiffness_unit)

    def _feedback(self, K: ArrayLike, B: ArrayLike, size: int) -> Floats:
        """Feedback (..., size): -f, as T²/m f, from the state in the order of `_open_loop`."""
        K, B = np.broadcast_arrays(np.asarray(K, float), np.asarray(B, float))
        if self.predictor.differences:
            damping = B * self.plant.rate
            now = self._of_velocity()._feedback(K + damping, 0.0, size - 1)
            return np.concatenate([now, -damping[..., None] / self.plant.stiffness_unit], axis=-1)
        gain = np.stack([K, B * self.plant.rate], axis=-1) / self.plant.stiffness_unit
        _, _, ahead = self._normalised()
        answers = np.zeros((*K.shape, size))
        seen = gain @ ahead
        answers[..., MOVES : MOVES + self.predictor.lags] = seen[..., STATES:]
        answers[..., -STATES:] = seen[..., :STATES]
        if self.static is not None:
            x, v, push = self.predictor.at_rest() @ np.stack([np.ones_like(K), -self.static * np.ones_like(K)])
            answers[..., -1] += (self.static - K * x - B * v) / push
        return answers

    def _of_velocity(self) -> PredictedLoop:
        return self._replace(predictor=self.predictor._replace(differences=False))

    def _normalised(self) -> tuple[Floats, Floats, Floats]:
        """Step with the reading, gains and ahead of the predictor, in m, sample periods and the plant's T²/m f."""
        one = self.predictor
        state = np.array([1.0, self.plant.rate, self.plant.stiffness_unit])
        columns = np.concatenate([state, np.full(one.lags, self.plant.stiffness_unit)])
        read = state[: len(one.reading)]
        rows = np.concatenate([state[:2], read])
        moves = np.vstack([one.step, one.reading]) / rows[:, None] * columns
        return moves, one.gains / state[:, None] * read, one.ahead / state[:2, None] * columns

    def _open_loop(self, moved: bool = True) -> tuple[Floats, Floats, Floats]:
        """Returns the open loop: (N, N) from the state at sample n, (N,) from T²/m f[n], (N, R) from noise on the
        readings. The state: position and velocity of the plant, the forces before f[n], the observer's. Without
        ``moved`` there is no plant, and the readings are the noise."""
        c = self.plant
        if self.predictor.differences:  # last number of the state: the position ahead, one sample ago
            moves, pushes, reads = self._of_velocity()._open_loop(moved)
            ahead = self._of_velocity()._feedback(c.stiffness_unit, 0.0, len(moves))
            moves = np.pad(np.vstack([moves, ahead]), ((0, 0), (0, 1)))
            return moves, np.append(pushes, 0.0), np.pad(reads, ((0, 1), (0, 0)))
        own = device_step(c.friction / c.damping_unit, c.delay, c.hold, c.stiffness / c.stiffness_unit, c.sampling)
        known = max(self.predictor.lags, own.forces.shape[1] - 1)
        expects, gains, _ = self._normalised()
        size = MOVES + 1 + known + STATES  # with f[n] as the first of the forces
        plant, observer = np.zeros((4, size)), np.zeros((len(expects), size))
        if moved:
            plant[:, :MOVES], plant[:, MOVES : MOVES + own.forces.shape[1]] = own.moves
        observer[:, -STATES:] = expects[:, :STATES]
        observer[:, MOVES : MOVES + self.predictor.lags] = expects[:, STATES:]
        state = np.zeros((STATES, size))
        state[:2], state[2, -1] = observer[:2], 1.0
        state += gains @ (plant[2 : len(expects)] - observer[2:])
        whole = np.zeros((size, size))
        whole[:MOVES], whole[-STATES:] = plant[:2], state
        whole[MOVES : MOVES + 1 + known, MOVES : MOVES + 1 + known] = np.eye(1 + known)
        # The force f[n-1-i] is f[n-2-i] one sample later: the rows of the new state are the old ones, shifted by one.
        rows = np.delete(whole, MOVES + known, axis=0)
        reads = np.zeros((size - 1, gains.shape[1]))
        reads[-STATES:] = gains
        return np.delete(rows, MOVES, axis=1), rows[:, MOVES], reads
