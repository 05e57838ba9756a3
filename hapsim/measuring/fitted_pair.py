"""The hand's pair of poles from a fitted polynomial, with its uncertainty."""

from __future__ import annotations

import cmath
import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.measuring.converters import Complexes, Floats
from hapsim.measuring.regression import Fit

NO_SECOND_REAL_POLE = "the slowest pole is real and no second real one follows"

TOO_FEW_POLES = "fewer than two poles are clear of its noise and rounding"

OVER_SOON = 0.7
"""Modulus of a pole: a smaller one decays within three samples, as those of delays, filters and holds."""

_MOST_SAMPLES = 4000  # of the motion
_CLEARLY = 30.0  # times the residual's variance: without this pole the motion fits clearly worse
_STILL = 0.1  # relative change over the motion: a mode that changes less counts as constant
_MOST = 0.95  # of the energy: beside such a mode a slower one is a small disturbance; two real modes share more evenly
_SOME = 1e-3  # of the energy
_SURE, _UNSURE = 0.02, 0.1  # relative uncertainties: beside a certain pair, a pole that is uncertain belongs to noise


class SecondMode(NamedTuple):
    """Another slow conjugate pair of poles that the motion clearly has: a further mass oscillates."""

    pole: complex
    """z-plane pole in the upper half."""
    share: float
    """Share of the energy of all modes. Energy: the squared position, summed over the free motion."""


class FittedPair(NamedTuple):
    """Two poles in the z-plane, their decay and stiffness, with standard uncertainties; NaN without a pair."""

    pole: complex = complex(math.nan, math.nan)
    """The pole with the larger modulus, in the upper half."""
    pole_uncertainty: float = math.nan  # of the distance in the plane
    decay: float = math.nan  # s1 + s2 times the sample period: minus the sum of both decays
    decay_uncertainty: float = math.nan
    stiffness: float = math.nan  # s1 s2 times the sample period squared
    stiffness_uncertainty: float = math.nan

    @property
    def unsure(self) -> float:
        """Larger of the relative uncertainties of decay and stiffness; of little of one, relative to the other."""
        k, b = abs(self.stiffness) + self.decay**2 / 4.0, abs(self.decay) + 0.1 * math.sqrt(abs(self.stiffness))
        return max(self.stiffness_uncertainty / max(k, 1e-300), self.decay_uncertainty / max(b, 1e-300))


class Poles(NamedTuple):
    """The poles of the motion from one fit."""

    pair: FittedPair | None  # the slowest-decaying one
    poles: Complexes  # all poles of the motion, by decreasing modulus
    reason: str  # the reason if there is no pair
    second: SecondMode | None


def dominant_pairs(fits: Sequence[tuple[Fit, Fit | None]], motion: Floats, stands: bool = False) -> list[Poles]:
    """Returns for each fit, all of one order, the slowest-decaying pair, or the pair with nearly all of the energy.

    Each fit comes with its alternative of another order, or None. Its distance adds to the uncertainty. `motion`: the
    free motion (samples,); only poles that it shows count. `stands`: the hand stays where it stops, without a spring.
    """
    every = _roots([fit for fit, _ in fits])
    seen, energy = _visible_poles(motion, every, stands)
    # The conjugate pair with most of the motion's energy is the hand. A slower mode beside it is a small disturbance.
    # Next come the poles that the motion shows. Real poles share their energy.
    whole = np.sum(energy * seen, axis=1, keepdims=True)
    is_hand = seen & (every.imag != 0.0) & (np.abs(every) >= OVER_SOON) & (2.0 * energy > _MOST * whole)
    order = np.argsort(~seen * 1 - is_hand, axis=1, kind="stable")
    every, energy = np.take_along_axis(every, order, 1), np.take_along_axis(energy, order, 1)
    shown = [(poles[:count], one[:count]) for poles, one, count in zip(every, energy, seen.sum(axis=1), strict=True)]
    return [_poles(fit, poles, one) for fit, poles, one in zip(fits, every, shown, strict=True)]


def _poles(fit: tuple[Fit, Fit | None], every: Complexes, shown: tuple[Complexes, Floats]) -> Poles:
    """Returns the poles of a fit, and the pair of the first two. If some pair is certain, poles that are not certain,
    alone or in a pair, are left out. `every`: all poles, those `shown` first, which the motion shows, with their
    energy."""
    poles, energy = shown
    orders = _candidates(every, poles.size)
    found = _pairs([fit] * len(orders), every[np.array(orders, int).reshape(-1, every.size)])
    unsure = [one.unsure for one in found]
    known = _unsure_alone(fit[0], every)
    for (i, j, *_), one in zip(orders, unsure, strict=True):
        known[[i, j]] = np.minimum(known[[i, j]], one if one < _SURE else math.inf)
    kept = np.arange(poles.size)
    if min(unsure, default=math.inf) < _SURE:
        kept = kept[known[kept] < _UNSURE]
    why = _why_no_pair(poles[kept])
    first = {*kept[: 1 if why or poles[kept[0]].imag else 2].tolist()}
    pair = None if why else next(one for order, one in zip(orders, found, strict=True) if first <= {*order[:2]})
    return Poles(pair, poles[kept], why, _second_mode(poles[kept], energy[kept]))


def _unsure_alone(fit: Fit, poles: Complexes) -> Floats:
    """Returns the uncertainty of each pole's decay rate, relative to it; infinite if another pole is the same."""
    slope = np.prod(poles[:, None] - poles + np.eye(poles.size), axis=1)
    moves = poles[:, None] ** np.arange(fit.order)[::-1] @ fit.directions.T @ fit.spread
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.nan_to_num(np.linalg.norm(moves, axis=1) / np.abs(slope * poles * np.log(poles)), nan=np.inf)


def _candidates(every: Complexes, shown: int) -> list[list[int]]:
    """Returns orders of the poles that begin with a conjugate pair or two positive real ones that the motion shows."""
    numbers, real = range(every.size), (every.imag == 0.0) & (every.real > 0.0)
    pairs = [(i, j) for i in range(shown) for j in numbers[i + 1 :]]
    pairs = [
        (i, j)
        for i, j in pairs
        if (real[[i, j]].all() and j < shown) or (every[i].imag and every[i] == every[j].conjugate())
    ]
    return [[i, j, *(k for k in numbers if k not in (i, j))] for i, j in pairs]


def _pairs(fits: Sequence[tuple[Fit, Fit | None]], poles: Complexes) -> list[FittedPair]:
    """Returns the pair of the first two poles of each fit. `poles`: (fits, order)."""
    if not fits:
        return []
    a = poles[:, 0]
    b = np.where(a.imag != 0.0, a.conjugate(), poles[:, 1])
    total, product = (a + b).real, (a * b).real
    spreads = _spreads_of_sum_and_product([fit for fit, _ in fits], total, product, poles[:, 2:])
    roots = iter(_roots([one for _, one in fits if one is not None]))
    for i, (_, one) in enumerate(fits):
        if one is not None:  # the two poles nearest to these
            others = next(roots)
            c, d = others[np.argsort(np.minimum(np.abs(others - a[i]), np.abs(others - b[i])))][:2]
            d = c.conjugate() if c.imag else d
            spreads[i] = np.column_stack([spreads[i], [(c + d).real - total[i], (c * d).real - product[i]]])
    return [_pair(*one) for one in zip(total.tolist(), product.tolist(), spreads, strict=True)]


def _roots(fits: Sequence[Fit]) -> Complexes:
    """Returns the poles (fits, order) of fits of one order, each by decreasing modulus."""
    order = fits[0].order if fits else 0
    companion = np.tile(np.eye(order, k=-1), (len(fits), 1, 1))
    for matrix, fit in zip(companion, fits, strict=True):
        matrix[0] = -fit.polynomial[1:]
    poles = np.linalg.eigvals(companion).astype(complex)
    return np.take_along_axis(poles, np.argsort(-np.abs(poles), axis=1, kind="stable"), axis=1)


def _why_no_pair(poles: Complexes) -> str:
    """Returns the reason if the two slowest poles are neither a conjugate pair nor both real and positive, else ""."""
    if poles.size < 2:
        return TOO_FEW_POLES
    if poles[0].imag != 0.0:
        return ""
    if poles[0].real <= 0.0:
        return "the slowest pole is real and negative: the position alternates from sample to sample"
    return NO_SECOND_REAL_POLE if poles[1].imag != 0.0 or poles[1].real <= 0.0 else ""


def _second_mode(poles: Complexes, energy: Floats) -> SecondMode | None:
    """Returns the conjugate pair with the most energy after the slowest pole, if it is slow and has some energy."""
    others = [i for i in range(1, poles.size) if poles[i].imag > 0.0 and abs(poles[i]) >= OVER_SOON]
    others = [i for i in others if abs(poles[i] - poles[0].conjugate()) > 1e-9 * abs(poles[0])]
    if not others or not np.sum(energy) > 0.0:
        return None
    most = max(others, key=lambda i: float(energy[i]))
    share = 2.0 * float(energy[most] / np.sum(energy))
    return SecondMode(complex(poles[most]), share) if share > _SOME else None


def _visible_poles(motion: Floats, poles: Complexes, stands: bool = False) -> tuple[NDArray[np.bool_], Floats]:
    """Returns which poles the motion shows, and the energy of each; all of shape (sets, order).

    Without such a pole a sum of modes fits the motion clearly worse. If the order of a fit exceeds the motion's, the
    further poles belong to its noise and may lie anywhere. The origin of the motion is not certain to the last count:
    the part that a constant explains is no mode, unless the hand `stands`.
    """
    seen, energy = np.ones(poles.shape, bool), np.zeros(poles.shape)
    still = np.any(np.abs(poles - 1.0) * motion.size < _STILL, axis=1) & stands
    for sets, with_constant in ((still, False), (~still, True)):
        if sets.any():
            seen[sets], energy[sets] = _visible_and_energy(motion, poles[sets], with_constant)
    return seen, energy


def _visible_and_energy(motion: Floats, poles: Complexes, with_constant: bool) -> tuple[NDArray[np.bool_], Floats]:
    seen, energy = np.ones(poles.shape, bool), np.zeros(poles.shape)
    if motion.size < poles.shape[1] + 2:
        return seen, energy
    size, grows = min(motion.size, _MOST_SAMPLES), np.abs(poles) > 1.0
    order = poles.shape[1]
    modes = np.ones((len(poles), order + with_constant + 1, size), complex)
    powers = modes[:, :order]
    powers[..., 1:] = np.where(grows, 1.0 / np.where(grows, poles, 1.0), poles)[..., None]
    np.multiply.accumulate(powers, axis=-1, out=powers)
    powers[grows] = powers[grows, ::-1]  # a growing mode runs backwards from its end, so that no power overflows
    modes[:, :-1] /= np.linalg.norm(modes[:, :-1], axis=-1, keepdims=True)
    modes[:, -1] = motion[:size]
    factor = np.asarray(np.linalg.qr(modes.swapaxes(1, 2), mode="r"))
    known = np.abs(np.diagonal(factor, axis1=1, axis2=2)[:, :-1]).min(axis=1) >= 1e-15
    factor = factor[known]
    inverse = np.linalg.inv(factor[:, :-1, :-1])
    amplitude = np.abs(inverse @ factor[:, :-1, -1:])[..., 0] ** 2
    worse = amplitude / np.sum(np.abs(inverse) ** 2, axis=2)
    left = np.abs(factor[:, -1, -1:]) ** 2
    least = _CLEARLY * left / size
    seen[known], energy[known] = (worse > least)[:, :order], amplitude[:, :order]
    for at, one, enough in zip(np.flatnonzero(known), factor, least[:, 0], strict=True):
        if not seen[at].all():
            seen[at] = _needed_poles(one, poles[at], float(enough))
    return seen, energy


def _needed_poles(factor: Complexes, poles: Complexes, least: float) -> NDArray[np.bool_]:
    """Returns which poles the motion needs. They are removed one by one or by conjugate pairs, the least needed first,
    because then a similar one may be needed. `factor`: triangular factor of the modes (poles first, motion last)."""
    left, others = np.ones(poles.size, bool), np.arange(poles.size, factor.shape[1])
    while left.any():
        r = np.asarray(np.linalg.qr(factor[:, np.append(np.flatnonzero(left), others)], mode="r"))
        inverse = np.linalg.inv(r[:-1, :-1])
        worse = (np.abs(inverse @ r[:-1, -1]) ** 2 / np.sum(np.abs(inverse) ** 2, axis=1))[: int(left.sum())]
        if np.min(worse) > least:
            break
        gone = poles[left][np.argmin(worse)]
        left &= ~np.isin(poles, [gone, gone.conjugate()])
    return left


def _spreads_of_sum_and_product(fits: Sequence[Fit], total: Floats, product: Floats, rest: Complexes) -> list[Floats]:
    """Returns a square root of the covariance of sum and product of each fit's pair, (2, n), to first order.

    A = Q R, so dA = R dQ + Q dR: a linear system for dQ (and dR), with known coefficients of dA."""
    order = fits[0].order
    others = np.ones((len(fits), 1), complex)  # R
    for root in rest.T:
        others = np.pad(others, ((0, 0), (0, 1)))
        others[:, 1:] -= root[:, None] * others[:, :-1]
    system = np.zeros((len(fits), order, order))
    system[:, : order - 1, 0] = -others.real  # by the sum: -z R
    system[:, 1:, 1] = others.real  # by the product: R
    for i in range(order - 2):
        system[:, i, 2 + i], system[:, i + 1, 2 + i], system[:, i + 2, 2 + i] = 1.0, -total, product
    directions = np.array([fit.directions.T for fit in fits])
    sensitivity = np.linalg.solve(system, directions)[:, :2]
    return [one @ fit.spread for one, fit in zip(sensitivity, fits, strict=True)]


def _pair(total: float, product: float, spread: Floats) -> FittedPair:
    """Returns the pair with this sum and product. `spread` (2, n): a square root of their covariance."""
    bend = total**2 / 4.0 - product  # squared half distance of the poles: its sign distinguishes real from complex
    bend_slope = np.array([total / 2.0, -1.0])
    half = cmath.sqrt(bend)
    bend_uncertainty = float(np.linalg.norm(bend_slope @ spread))
    if abs(bend) > 40.0 * bend_uncertainty:
        uncertainty = float(np.linalg.norm((np.array([0.5, 0.0]) + bend_slope / (2.0 * half)) @ spread))
    else:
        # If the poles may coincide, the square root is far from linear. The uncertainty is a quarter of its change when
        # the bend is off by four uncertainties: four of one then cover four of the other.
        reach = max(abs(cmath.sqrt(bend + side * bend_uncertainty) - half) for side in (-4.0, 4.0)) / 4.0
        uncertainty = math.hypot(0.5 * float(np.linalg.norm(spread[0])), reach)
    decay, stiffness, slopes = _decay_and_stiffness(total, product)
    off_decay, off_stiffness = np.linalg.norm(slopes @ spread, axis=1).tolist()
    return FittedPair(complex(total / 2.0 + half), uncertainty, decay, off_decay, stiffness, off_stiffness)


def _decay_and_stiffness(total: float, product: float) -> tuple[float, float, Floats]:
    """Returns (s1 + s2) T, s1 s2 T² and their slopes by sum and product, smooth even if the poles coincide.

    With mu² the product and cosine c = sum / (2 mu): s1 s2 T² = ln(mu)² + angle², where cos(angle) = c; two real poles
    have an imaginary angle.
    """
    logarithm = 0.5 * math.log(product)
    mu = math.exp(logarithm)
    cosine = total / (2.0 * mu)
    away = (total - 2.0 * mu) / (2.0 * mu)  # cosine - 1 without cancellation
    if abs(away) < 1e-6:
        angle_squared, slope = -2.0 * away * (1.0 - away / 6.0), -2.0 + 2.0 * away / 3.0
    else:
        angle = cmath.acos(cosine)
        angle_squared, slope = (angle**2).real, (-2.0 * angle / cmath.sin(angle)).real
    cosine_slope = np.array([1.0 / (2.0 * mu), -cosine / (2.0 * product)])
    slopes = np.array([[0.0, 1.0 / product], slope * cosine_slope + np.array([0.0, logarithm / product])])
    return 2.0 * logarithm, logarithm**2 + angle_squared, slopes
