"""The closed loop of a real mass, and a force that answers the state which a predictor expects of it.

The predictor may have been made for another mass than the real one: that is what its errors cost.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.correction.state_predictor import StatePredictor
from hapsim.theory.hand import Configuration
from hapsim.theory.hand.impedance import late_and_held
from hapsim.theory.hand.pair import oscillator_of_quadratic
from hapsim.theory.hand.plant import Plant, sampled_plant
from hapsim.theory.hand.poles import pair_of_poles, roots


class PredictedLoop(NamedTuple):
    """A real ``plant``, and the ``predictor`` whose state (x, v) the force f = -K x - B v answers.

    With the plant's mass in the predictor the loop has two poles and zeros: those of the same mass without a delay.
    """

    plant: Configuration
    predictor: StatePredictor

    def characteristic(self, K: ArrayLike, B: ArrayLike) -> Floats:
        """Coefficients (..., N + 1) of the monic characteristic polynomial in z, highest power first.

        With 1/G = z^lead (w² + p w + q) / numerator of the plant and f (1 + gain forces) = -gain readings.
        K in N/m, B in N·s/m; arrays broadcast.
        """
        own = sampled_plant(
            self.plant.friction / self.plant.damping_unit,
            self.plant.stiffness / self.plant.stiffness_unit,
            self.plant.delay,
            self.plant.hold,
            self.plant.sampling,
        )
        gain = np.stack(np.broadcast_arrays(np.asarray(K, float), np.asarray(B, float)), axis=-1)
        answer = self._answer(own, gain)
        free = np.convolve([1.0, own.p - 2.0, 1.0 - own.p + own.q], np.append(1.0, np.zeros(max(own.lead, 0))))
        past = np.concatenate([np.ones((*gain.shape[:-1], 1)), gain @ self.predictor.forces], axis=-1)
        rest = _product(past, free)
        if own.lead < 0:
            answer = _product(answer, np.append(1.0, np.zeros(-own.lead)))
        size = max(rest.shape[-1], answer.shape[-1])
        total = _padded(rest, size) + _padded(answer, size)
        return np.asarray(total / total[..., :1])

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """All poles (..., N) in the z-plane, by decreasing modulus; those of the predictor's memories near zero."""
        return roots(self.characteristic(K, B))

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
        """Force over velocity, N·s/m, that is rendered at frequencies (n,) in Hz to a hand of whose force the predictor
        knows nothing, the device's own left out; where no velocities are sent. NaN from the Nyquist frequency on, and
        at 0."""
        f = np.asarray(frequency, dtype=float)
        theta = 2.0 * np.pi * f * self.plant.period
        some = (theta > 0.0) & (theta < np.pi)
        earlier = np.exp(-1j * theta[some, None] * np.arange(1.0, self.predictor.lags + 1.0))  # z^-1, z^-2, ...
        gain = np.array([K, B])
        (first, second), forces = gain @ self.predictor.readings, gain @ self.predictor.forces
        answer = (first + second * earlier[:, 0]) / (1.0 + earlier @ forces)
        through = late_and_held(theta[some], self.plant.delay, self.plant.hold, self.plant.sampling)
        found = np.full(f.shape, np.nan, dtype=complex)
        found[some] = answer * through / (2j * np.pi * f[some])
        return found

    def _answer(self, own: Plant, gain: Floats) -> Floats:
        """numerator (gain readings) z^lags: what is read answers, in units of T²/m f; the second reading is that of
        sample n - 1, or the velocity V = (w velocity / (z numerator) + offset) Y."""
        lags = self.predictor.lags
        first, second = np.moveaxis(gain @ self.predictor.readings, -1, 0) / self.plant.stiffness_unit
        later, earlier = np.append(1.0, np.zeros(lags)), np.append([0.0, 1.0], np.zeros(lags - 1))
        if not self.predictor.senses:
            return _product(first[..., None] * later + second[..., None] * earlier, own.numerator)
        second = second * self.plant.rate
        moving = np.convolve(np.convolve([1.0, -1.0], own.velocity), earlier)
        level = _product((first + second * own.offset)[..., None] * later, own.numerator)
        size = max(level.shape[-1], moving.size)
        return _padded(level, size) + second[..., None] * _padded(moving, size)


def _product(several: Floats, one: Floats) -> Floats:
    """Polynomials (..., n), each times one."""
    result = np.zeros((*several.shape[:-1], several.shape[-1] + one.size - 1))
    for i, coefficient in enumerate(one):
        result[..., i : i + several.shape[-1]] += coefficient * several
    return result


def _padded(polynomials: Floats, size: int) -> Floats:
    """(..., size): the same with zeros for the highest powers."""
    missing = size - polynomials.shape[-1]
    return np.concatenate([np.zeros((*polynomials.shape[:-1], missing)), polynomials], axis=-1)
