"""The closed loop of a real mass, and a force that answers the state which a predictor expects of it.

The predictor may have been made for another mass than the real one: that is what its errors cost.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Complexes, Floats, sort_by_modulus
from hapsim.theory.correction.state_predictor import STATES, StatePredictor
from hapsim.theory.device_step import device_step
from hapsim.theory.hand import Configuration
from hapsim.theory.hand.impedance import late_and_held
from hapsim.theory.hand.pole_pair import oscillator_of_quadratic
from hapsim.theory.hand.poles import pair_of_poles

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
