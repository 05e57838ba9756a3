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
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

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
    STATES,
    StatePredictor,
    acting_at_sample,
    damper_named,
    hold_segments,
    whole_and_fraction,
)
from hapsim.theory.network.crossings import Crossings, LinkChanges
from hapsim.theory.network.network import BACKWARD
from hapsim.theory.observer import Observers
from hapsim.theory.rows import cut

READING, MEAN_VELOCITY = 2, 3  # rows of a DeviceStep
SLOWEST = 0.5
"""Double pole of the observer: nearer to 0 it has more noise, nearer to 1 it follows a new push more slowly."""


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
        moves, gains = np.array([[1.0, 0.0, 1.0], [0.0, 0.0, 0.0]]), np.array([[1.0, 0.0], [0.0, 1.0], [1.0, 0.0]])
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
        mass=model.mass,
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


def filtered_noise_gain(change: Floats, push: Floats, answer: Floats, read: Floats) -> float:
    """Force rms of a stable loop per white noise of 1 rms on a reading that acts by ``read`` (n + 1,): the newest value
    first. ``change``, ``push``, ``answer``: as in ``white_noise_gain``."""
    size, more = len(change), len(read) - 1
    closed = np.zeros((size + more, size + more))
    closed[:size, :size] = np.eye(size) + change - np.outer(push, answer)
    closed[:size, size:] = -np.outer(push, read[1:])
    closed[size + 1 :, size:-1] = np.eye(more - 1)
    entered = np.zeros((size + more, 1))
    entered[:size, 0], entered[size, 0] = -push * read[0], 1.0
    return math.hypot(read[0], _noise(closed, entered, np.append(answer, read[1:])))


def _noise(power: Floats, reads: Floats, answers: Floats) -> float:
    """Returns the rms of ``answers`` on a state that ``power`` moves, from white noise of 1 rms through ``reads``; NaN
    if rounding hides that the loop forgets."""
    spread: Floats = reads @ reads.T
    for _ in range(DOUBLINGS):  # twice as many samples of noise each time
        if np.abs(power).max() <= NEGLIGIBLE:
            return float(np.sqrt(max(float(answers @ spread @ answers), 0.0)))
        spread = spread + power @ spread @ power.T
        power = power @ power
    return math.nan


def forces_at_sample(model: Configuration, age: int) -> tuple[Floats, int]:
    """Returns (weights, first) of the force that acts at a sample: the sum of weights[i] f[n - first - i]. ``age`` 0:
    just after sample n; 1: just before it, as always if f[n] would act at once. No weights: an impulse is over."""
    weights = np.array(acting_at_sample(model.delay, model.hold, age))
    acting = np.flatnonzero(weights)
    return (weights[acting[0] : acting[-1] + 1], int(acting[0]) + 1) if acting.size else (weights[:0], 1)


DOUBLINGS = 64  # a pole that is one rounding below 1 has died away after 58
NEGLIGIBLE = 1e-12  # of the oldest noise: its square is beyond rounding
MOVES = 2  # numbers of the plant's state: position and velocity


@dataclass(frozen=True, eq=False)
class PredictedLoop:
    """Closed loop of a real ``plant`` and a ``predictor`` with the state (x, v, push): f = -K x - B v - g push. The
    share g is 0 without ``static``. With ``static`` (N/m) it makes a steady push meet this stiffness beside the
    device's own spring. If the predictor has the plant's mass, the loop has the two poles of this mass without a delay,
    those of the observer, and zeros."""

    plant: Configuration
    predictor: StatePredictor
    static: float | Floats | None = None

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """Poles (..., N) in the z-plane, by decreasing modulus; K in N/m, B in N·s/m; arrays broadcast."""
        answers = self._feedback(K, B)
        finite = np.isfinite(answers).all(axis=-1, keepdims=True)
        closed = self._rows.moves - self._rows.pushes[:, None] * np.where(finite, answers, 0.0)[..., None, :]
        return np.where(finite, sort_by_modulus(np.linalg.eigvals(closed).astype(complex)), np.nan)

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """Felt (k, b) in N/m and N·s/m, as ``Configuration.equivalent`` defines them."""
        _, k, b = self.solved(K, B)
        return k, b

    @np.errstate(all="ignore")
    def solved(self, K: ArrayLike, B: ArrayLike) -> tuple[Complexes, Floats, Floats]:
        """Returns ``poles`` and the two of ``equivalent``, in the time of one of them."""
        p, q, dominant = pair_of_poles(poles := self.poles(K, B))
        sigma, kappa = oscillator_of_quadratic(p, q)
        k, b = kappa * self.plant.stiffness_unit, sigma * self.plant.damping_unit
        return poles, np.where(dominant, k, np.nan)[()], np.where(dominant, b, np.nan)[()]

    def spectral_radius(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Largest modulus of a pole."""
        return np.asarray(np.abs(self.poles(K, B)[..., 0]))[()]

    @np.errstate(all="ignore")
    def steady_stiffness(self, K: float, B: float) -> float:
        """Stiffness that a steady push meets, N/m, at a velocity reading of 0, without the device's own spring."""
        if self.static is not None:
            return float(self.static)
        (x, by_x), (v, by_v), _ = self.predictor.at_rest().tolist()
        B = 0.0 if self.predictor.differences else B
        return float(np.divide(K * x + B * v, 1.0 + K * by_x + B * by_v))

    def noise_gain(self, K: float, B: float) -> float:
        """Noise gain of the closed loop: N rms of force per m rms of white noise on the positions, with an equal noise
        per sample period on the velocities; infinity if unstable."""
        if not self.spectral_radius(K, B) < 1.0:
            return math.inf
        rows, answers = self._rows, self._feedback(K, B)
        return _noise(rows.moves - np.outer(rows.pushes, answers), rows.reads, answers) * self.plant.stiffness_unit

    def stable_stiffness(self, B: float) -> tuple[float, float]:
        """Lowest interval (least, most) of K, N/m, in which the loop is stable for B in N·s/m; NaN if there is none."""
        return self._interval(lambda K: (K, B), self.plant.stiffness_unit)

    def stable_damping(self, K: float) -> tuple[float, float]:
        """Lowest interval (least, most) of B, N·s/m, in which the loop is stable for K in N/m; NaN if there is none."""
        return self._interval(lambda B: (K, B), self.plant.damping_unit)

    @np.errstate(all="ignore")
    def _interval(self, element: Callable[[Any], tuple[Any, Any]], unit: float) -> tuple[float, float]:
        """Returns the lowest stable interval above -``unit``; stability does not change between two crossings."""
        rows, still = self._rows, self._feedback(*element(0.0))
        change = rows.moves - np.eye(len(rows.moves)) - np.outer(rows.pushes, still)
        by_unit = still - self._feedback(*element(unit))
        try:
            links = LinkChanges(change, rows.pushes[:, None], (by_unit[None], by_unit[None]))
            crossings = Crossings(links).factors(0, 0)
        except np.linalg.LinAlgError:  # out of range
            return math.nan, math.nan
        edges = np.array([-unit, *(unit * (crossings - 1.0)), math.inf])
        inside = np.append(0.5 * (edges[:-2] + edges[1:-1]), 3.0 * abs(edges[-2]) + unit)
        stable = self.spectral_radius(*element(inside)) < 1.0
        if not stable.any():
            return math.nan, math.nan
        first = int(np.argmax(stable))
        ends = np.flatnonzero(~stable[first:])
        return float(edges[first]), float(edges[first + ends[0]] if ends.size else math.inf)

    def _feedback(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Feedback (..., size): -f, as T²/m f, from the state in the order of `_rows`."""
        K, B = np.broadcast_arrays(np.asarray(K, float), np.asarray(B, float))
        gain = np.stack([K, B * self.plant.rate], axis=-1) / self.plant.stiffness_unit
        answers = gain @ self._rows.ahead
        if self.static is not None:
            x, v, push = self.predictor.at_rest() @ np.stack([np.ones_like(K), -self.static * np.ones_like(K)])
            answers[..., -1] += (self.static - K * x - B * v) / push
        return np.asarray(answers)

    @cached_property
    def _rows(self) -> _LoopRows:
        c, predictor = self.plant, self.predictor
        own = device_step(c.friction / c.damping_unit, c.delay, c.hold, c.stiffness / c.stiffness_unit, c.sampling)
        observer = Observers([predictor], np.array([c.mass]), c.rate)
        known = max(predictor.lags, own.forces.shape[1] - 1)
        sizes = {"last": int(predictor.differences), "plant": MOVES, "held": known, "observer": STATES}
        size, more = sum(sizes.values()), {"force": 1, "noise": observer.readings}
        rows = cut(np.eye(size + 1 + observer.readings), sizes | more)
        forces, (motion, made) = np.vstack([rows["force"], rows["held"]]), own.moves
        plant = motion @ rows["plant"] + made @ forces[: made.shape[1]]
        read = plant[MOVES : MOVES + observer.readings] + rows["noise"]
        of_observer = rows["observer"] + observer.change(rows["observer"], forces, read[:, None])
        x, v = observer.ahead(rows["observer"], rows["held"])
        new = np.vstack([x[: sizes["last"]], plant[:MOVES], forces[:known], of_observer])
        ahead = np.vstack([x, x - rows["last"] if predictor.differences else v])
        return _LoopRows(new[:, :size], new[:, size], new[:, size + 1 :], ahead[:, :size])


class _LoopRows(NamedTuple):
    """Open loop: the new state from the state, ``moves`` (N, N), from T²/m f[n], ``pushes`` (N,), and from noise on the
    readings, ``reads`` (N, R); and position and velocity as links see them, ``ahead`` (2, N). The state: the position
    ahead one sample ago, for a damper of differences; the plant; the forces before f[n]; the observer."""

    moves: Floats
    pushes: Floats
    reads: Floats
    ahead: Floats
