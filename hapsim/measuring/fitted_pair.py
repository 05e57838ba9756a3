"""The pair of poles that moves the hand, out of a fitted polynomial, with its uncertainty."""

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

_LOOKED_AT = 4000  # samples of the motion
_CLEARLY = 30.0  # times the residual's variance: a pole without which the motion fits clearly worse
_LASTING = 0.7  # what loses more in a sample is gone after three: poles of delays, filters and holds
_STILL = 0.1  # of itself: what changes by less over the motion is as good as constant
_MOST = 0.95  # of the energy: what rings longer beside that is a small disturbance; two real modes share it more evenly
_SOME = 1e-3  # of the energy


class SecondMode(NamedTuple):
    """Another conjugate pair of poles that the motion clearly has, and that lasts: a further mass swings along."""

    pole: complex
    """z-plane, in the upper half."""
    share: float
    """Of the energy (of the squared position, over the free motion) that this pair has of all modes."""


class FittedPair(NamedTuple):
    """Two poles in the z-plane and what follows from them, with standard uncertainties; NaN without a pair."""

    pole: complex = complex(math.nan, math.nan)
    """The one with the larger modulus, in the upper half."""
    pole_uncertainty: float = math.nan  # of the distance in the plane
    decay: float = math.nan  # s1 + s2 times the sample period: minus the sum of both decays
    decay_uncertainty: float = math.nan
    stiffness: float = math.nan  # s1 s2 times the sample period squared
    stiffness_uncertainty: float = math.nan


class Poles(NamedTuple):
    """What one fit says of the motion."""

    pair: FittedPair | None  # the slowest-decaying one
    poles: Complexes  # all that the motion has, by decreasing modulus
    reason: str  # why there is no pair
    second: SecondMode | None


def dominant_pairs(fits: Sequence[tuple[Fit, Fit | None]], motion: Floats, stands: bool = False) -> list[Poles]:
    """The slowest-decaying pair of each of some fits of one order, or that with nearly all of the energy.

    Beside each fit: one of another order that might as well have been chosen; how far it lies from the fit adds to the
    uncertainty. `motion`: the position, shape (samples,), in which a pole has to be seen in order to count. `stands`:
    whether the hand stays where it stops, for lack of a spring.
    """
    every = _roots([fit for fit, _ in fits])
    seen, energy = _seen_in(motion, every, stands)
    # The conjugate pair that has most of the motion's energy is the hand, and what rings longer beside it is a small
    # disturbance; then come those that are seen. Real poles share their energy.
    whole = np.sum(energy * seen, axis=1, keepdims=True)
    is_hand = seen & (every.imag != 0.0) & (np.abs(every) >= _LASTING) & (2.0 * energy > _MOST * whole)
    order = np.argsort(~seen * 1 - is_hand, axis=1, kind="stable")
    every, energy = np.take_along_axis(every, order, 1), np.take_along_axis(energy, order, 1)
    shown = [(poles[:count], one[:count]) for poles, one, count in zip(every, energy, seen.sum(axis=1), strict=True)]
    reasons = [_why_no_pair(poles) for poles, _ in shown]
    paired = [i for i, why in enumerate(reasons) if not why]
    found = _pairs([fits[i] for i in paired], every[paired])
    pairs = dict(zip(paired, found, strict=True))
    return [Poles(pairs.get(i), one[0], reasons[i], _second_mode(*one)) for i, one in enumerate(shown)]


def _pairs(fits: Sequence[tuple[Fit, Fit | None]], poles: Complexes) -> list[FittedPair]:
    """The pair of the first two poles of each fit; poles: (fits, order)."""
    if not fits:
        return []
    a = poles[:, 0]
    b = np.where(a.imag != 0.0, a.conjugate(), poles[:, 1])
    total, product = (a + b).real, (a * b).real
    spreads = _spreads_of_sum_and_product([fit for fit, _ in fits], total, product, poles[:, 2:])
    roots = iter(_roots([one for _, one in fits if one is not None]))
    for i, (_, one) in enumerate(fits):
        if one is not None:  # the two poles that take the places of these
            others = next(roots)
            c, d = others[np.argsort(np.minimum(np.abs(others - a[i]), np.abs(others - b[i])))][:2]
            d = c.conjugate() if c.imag else d
            spreads[i] = np.column_stack([spreads[i], [(c + d).real - total[i], (c * d).real - product[i]]])
    return [_pair(*one) for one in zip(total.tolist(), product.tolist(), spreads, strict=True)]


def _roots(fits: Sequence[Fit]) -> Complexes:
    """The poles of fits of one order, shape (fits, order), each by decreasing modulus."""
    order = fits[0].order if fits else 0
    companion = np.tile(np.eye(order, k=-1), (len(fits), 1, 1))
    for matrix, fit in zip(companion, fits, strict=True):
        matrix[0] = -fit.polynomial[1:]
    poles = np.linalg.eigvals(companion).astype(complex)
    return np.take_along_axis(poles, np.argsort(-np.abs(poles), axis=1, kind="stable"), axis=1)


def _why_no_pair(poles: Complexes) -> str:
    """Why the two slowest poles are neither a conjugate pair nor both real and positive; "" where they are."""
    if poles.size < 2:
        return "fewer than two poles are clear of its noise and rounding"
    if poles[0].imag != 0.0:
        return ""
    if poles[0].real <= 0.0:
        return "the slowest pole is real and negative: the position alternates from sample to sample"
    return NO_SECOND_REAL_POLE if poles[1].imag != 0.0 or poles[1].real <= 0.0 else ""


def _second_mode(poles: Complexes, energy: Floats) -> SecondMode | None:
    """Of the conjugate pairs behind the slowest pole the one with the most energy, where it lasts and that is some."""
    others = [i for i in range(1, poles.size) if poles[i].imag > 0.0 and abs(poles[i]) >= _LASTING]
    others = [i for i in others if abs(poles[i] - poles[0].conjugate()) > 1e-9 * abs(poles[0])]
    if not others or not np.sum(energy) > 0.0:
        return None
    most = max(others, key=lambda i: float(energy[i]))
    share = 2.0 * float(energy[most] / np.sum(energy))
    return SecondMode(complex(poles[most]), share) if share > _SOME else None


def _seen_in(motion: Floats, poles: Complexes, stands: bool = False) -> tuple[NDArray[np.bool_], Floats]:
    """(which poles the motion has: those without which a sum of modes would fit it clearly worse; the energy of each),
    for several sets of poles, all of shape (sets, order).

    A fit of a higher order than the motion's has poles that belong to its noise; they may lie anywhere. From where the
    motion is counted is not certain to the last count: what a constant explains is no mode, unless the hand `stands`.
    """
    seen, energy = np.ones(poles.shape, bool), np.zeros(poles.shape)
    still = np.any(np.abs(poles - 1.0) * motion.size < _STILL, axis=1) & stands
    for sets, with_constant in ((still, False), (~still, True)):
        if sets.any():
            seen[sets], energy[sets] = _shown_by(motion, poles[sets], with_constant)
    return seen, energy


def _shown_by(motion: Floats, poles: Complexes, with_constant: bool) -> tuple[NDArray[np.bool_], Floats]:
    seen, energy = np.ones(poles.shape, bool), np.zeros(poles.shape)
    if motion.size < poles.shape[1] + 2:
        return seen, energy
    size, grows = min(motion.size, _LOOKED_AT), np.abs(poles) > 1.0
    order = poles.shape[1]
    modes = np.ones((len(poles), order + with_constant + 1, size), complex)
    powers = modes[:, :order]
    powers[..., 1:] = np.where(grows, 1.0 / np.where(grows, poles, 1.0), poles)[..., None]
    np.multiply.accumulate(powers, axis=-1, out=powers)
    powers[grows] = powers[grows, ::-1]  # a growing mode is written backwards from its end: no power overflows
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
            seen[at] = _needed(one, poles[at], float(enough))
    return seen, energy


def _needed(factor: Complexes, poles: Complexes, least: float) -> NDArray[np.bool_]:
    """Without the least needed pole, another one that is like it may be needed: they are taken out one by one, or by
    conjugate pairs. `factor`: the triangular one of the modes, those of the poles first, the motion last."""
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
    """To first order: A = Q R, so dA = R dQ + Q dR, a linear system for dQ (and dR) with dA's coefficients known."""
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
    """The pair with this sum and product, of which `spread` (2, n) is a square root of the covariance."""
    bend = total**2 / 4.0 - product  # squared half distance of the poles: its sign distinguishes real from complex
    bend_slope = np.array([total / 2.0, -1.0])
    half = cmath.sqrt(bend)
    bend_uncertainty = float(np.linalg.norm(bend_slope @ spread))
    if abs(bend) > 40.0 * bend_uncertainty:
        uncertainty = float(np.linalg.norm((np.array([0.5, 0.0]) + bend_slope / (2.0 * half)) @ spread))
    else:
        # Where the poles may have met, the square root is anything but linear: a quarter of how far it reaches when
        # the bend is off by four uncertainties, so that four of the value stated cover what four of the bend's do.
        reach = max(abs(cmath.sqrt(bend + side * bend_uncertainty) - half) for side in (-4.0, 4.0)) / 4.0
        uncertainty = math.hypot(0.5 * float(np.linalg.norm(spread[0])), reach)
    decay, stiffness, slopes = _decay_and_stiffness(total, product)
    off_decay, off_stiffness = np.linalg.norm(slopes @ spread, axis=1).tolist()
    return FittedPair(complex(total / 2.0 + half), uncertainty, decay, off_decay, stiffness, off_stiffness)


def _decay_and_stiffness(total: float, product: float) -> tuple[float, float, Floats]:
    """(s1 + s2) T, s1 s2 T² and their slopes by sum and product, smooth where the poles meet.

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
