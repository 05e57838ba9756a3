"""What a computer can do about the deformation: predict the state in which the mass will meet the force.

Florens et al. (§6.3) ask for it: "additional speed and acceleration sensor may be used to compensate the effect of
delay". With the mass known, no sensor is needed. An observer keeps position, velocity and the steady push of the hand;
from sample to sample the forces that acted lead them on, and what is read corrects them; the forces that are on their
way lead them to the instant (n + delay) T. Of a mass that is the declared one, under no push, the state is exact from
the second sample on, whatever it was before; a push that changes is found as the observer's poles say. The predictor
may have been made for another mass than the real one: that is what its errors cost (`PredictedLoop`).
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
from hapsim.theory.interface import SAMPLINGS, damper_named, hold_segments, late_and_held, whole_and_fraction
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
    """(3, 2): position and velocity as read, given the push, which takes 1 - pole of what that leaves unexplained."""
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


NOTHING_LEFT = 1e-12  # of the noise of long ago: its square is beyond rounding
MOVES = 2  # numbers of the state that are the plant's: position and velocity


class PredictedLoop(NamedTuple):
    """A real ``plant``, and the ``predictor`` whose state (x, v, push) the force f = -K x - B v - g push answers.

    With ``static`` (N/m) the share g is the one with which a steady push meets this stiffness beside the device's own
    spring; else it is 0. With the plant's mass in the predictor the loop has the two poles of the same mass without a
    delay, those of the observer, and zeros.
    """

    plant: Configuration
    predictor: StatePredictor
    static: float | Floats | None = None

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """All poles (..., N) in the z-plane, by decreasing modulus; K in N/m, B in N·s/m; arrays broadcast."""
        moves, pushes, _ = self._open_loop()
        answers = self._answers(K, B, len(moves))
        finite = np.isfinite(answers).all(axis=-1, keepdims=True)
        closed = moves - pushes[:, None] * np.where(finite, answers, 0.0)[..., None, :]
        return np.where(finite, sort_by_modulus(np.linalg.eigvals(closed).astype(complex)), np.nan)

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """The real (k, b), N/m and N·s/m, that the hand feels, as of ``Configuration.equivalent``."""
        with np.errstate(all="ignore"):
            p, q, dominant = pair_of_poles(self.poles(K, B))
            sigma, kappa = oscillator_of_quadratic(p, q)
            k, b = kappa * self.plant.stiffness_unit, sigma * self.plant.damping_unit
            return np.where(dominant, k, np.nan)[()], np.where(dominant, b, np.nan)[()]

    def spectral_radius(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """The largest modulus of a pole."""
        return np.asarray(np.abs(self.poles(K, B)[..., 0]))[()]

    def impedance(self, K: float, B: float, frequency: ArrayLike) -> Complexes:
        """Force over velocity, N·s/m, that is rendered at frequencies (n,) in Hz to a hand whose force the predictor
        does not know, without the device's own; where no velocities are sent. NaN from the Nyquist frequency on, and
        at 0."""
        f = np.asarray(frequency, dtype=float)
        theta = 2.0 * np.pi * f * self.plant.period
        some = (theta > 0.0) & (theta < np.pi)
        through = late_and_held(theta[some], self.plant.delay, self.plant.hold, self.plant.sampling)
        found = np.full(f.shape, np.nan, dtype=complex)
        found[some] = self._stiffness_at(np.exp(1j * theta[some]), K, B) * through / (2j * np.pi * f[some])
        return found

    def steady_stiffness(self, K: float, B: float) -> float:
        """N/m: what a steady push meets, read with a velocity of 0, without the device's own spring."""
        return float(self._stiffness_at(np.ones(1, dtype=complex), K, B)[0].real)

    def noise_gain(self, K: float, B: float) -> float:
        """N rms of force that comes of each m rms of white noise on the positions, and of as much as that is in a
        sample period on the velocities, while the loop is closed; infinity where it is unstable."""
        if not self.spectral_radius(K, B) < 1.0:
            return math.inf
        moves, pushes, reads = self._open_loop()
        answers = self._answers(K, B, len(moves))
        power: Floats = moves - np.outer(pushes, answers)
        spread: Floats = reads @ reads.T
        while np.abs(power).max() > NOTHING_LEFT:  # twice as many samples of noise each time
            spread = spread + power @ spread @ power.T
            power = power @ power
        return float(np.sqrt(max(float(answers @ spread @ answers), 0.0)) * self.plant.stiffness_unit)

    def _stiffness_at(self, z: Complexes, K: float, B: float) -> Complexes:
        """(n,) N/m: force over the position that is read, at z."""
        moves, pushes, reads = self._open_loop(moved=False)
        answers = self._answers(K, B, len(moves))
        alone = moves - np.outer(pushes, answers)
        if not np.isfinite(alone).all():
            return np.full(z.shape, np.nan, dtype=complex)
        state = np.linalg.solve(z[:, None, None] * np.eye(len(alone)) - alone, z[:, None, None] * reads[:, :1])
        return np.asarray(state[..., 0] @ answers * self.plant.stiffness_unit)

    def _answers(self, K: ArrayLike, B: ArrayLike, size: int) -> Floats:
        """(..., size): -f, in T²/m f, of the state as `_open_loop` orders it."""
        K, B = np.broadcast_arrays(np.asarray(K, float), np.asarray(B, float))
        if self.predictor.differences:
            damping = B * self.plant.rate
            now = self._of_velocity()._answers(K + damping, 0.0, size - 1)
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
        """(N, N), (N,) and (N, R): the state at the next sample from that at sample n, from T²/m f[n], and from noise
        on the readings. The state: position and velocity of the plant, the forces before f[n], the observer's.
        ``moved``: whether the plant is there; where it is not, the readings are the noise."""
        c = self.plant
        if self.predictor.differences:  # the position ahead, a sample later: the last number of the state
            moves, pushes, reads = self._of_velocity()._open_loop(moved)
            ahead = self._of_velocity()._answers(c.stiffness_unit, 0.0, len(moves))
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
        # What was f[n-1-i] is f[n-2-i] a sample later: the rows of the new state are those of the old, one further on.
        rows = np.delete(whole, MOVES + known, axis=0)
        reads = np.zeros((size - 1, gains.shape[1]))
        reads[-STATES:] = gains
        return np.delete(rows, MOVES, axis=1), rows[:, MOVES], reads
