"""The pair of poles that moves the hand, out of a fitted polynomial, with its uncertainty."""

from __future__ import annotations

import cmath
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.measuring.converters import Complexes, Floats
from hapsim.measuring.regression import Fit

NO_SECOND_REAL_POLE = "the slowest pole is real and no second real one follows"

_LOOKED_AT = 4000  # samples of the motion
_CLEARLY = 30.0  # times the residual's variance: a pole without which the motion fits clearly worse
_LASTING = 0.7  # what loses more in a sample is gone after three: poles of delays, filters and holds
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
    pole_uncertainty: float = math.nan
    """Of the distance in the plane."""
    decay: float = math.nan
    """s1 + s2 times the sample period: minus the sum of both decays."""
    decay_uncertainty: float = math.nan
    stiffness: float = math.nan
    """s1 s2 times the sample period squared."""
    stiffness_uncertainty: float = math.nan


class Poles(NamedTuple):
    """What one fit says of the motion."""

    pair: FittedPair | None
    """The slowest-decaying one."""
    poles: Complexes
    """All that the motion has, by decreasing modulus."""
    reason: str
    """Why there is no pair."""
    second: SecondMode | None


def dominant_pair(fit: Fit, alternatives: list[Fit], motion: Floats) -> Poles:
    """The slowest-decaying pair of a fit.

    `alternatives`: fits that might as well have been chosen; how far they lie from `fit` adds to the uncertainty.
    `motion`: the position, shape (samples,), in which a pole has to be seen in order to count.
    """
    every = _roots(fit)
    seen, energy = _seen_in(motion, every)
    poles, second = every[seen], _second_mode(every[seen], energy[seen])
    if why := _why_no_pair(poles):
        return Poles(None, poles, why, second)
    a, b = poles[0], poles[0].conjugate() if poles[0].imag else poles[1]
    total, product = (a + b).real, (a * b).real
    spread = [_spread_of_sum_and_product(fit, total, product, np.append(poles[2:], every[~seen]))]
    for other in map(_roots, alternatives):  # the two poles that take the places of these
        c, d = other[np.argsort(np.minimum(np.abs(other - a), np.abs(other - b)))][:2]
        d = c.conjugate() if c.imag else d
        spread.append(np.array([[(c + d).real - total], [(c * d).real - product]]))
    return Poles(_pair(total, product, np.hstack(spread)), poles, "", second)


def _roots(fit: Fit) -> Complexes:
    companion = np.eye(fit.order, k=-1)
    companion[0] = -fit.polynomial[1:]
    poles = np.linalg.eigvals(companion).astype(complex)
    return poles[np.argsort(-np.abs(poles), kind="stable")]


def _why_no_pair(poles: Complexes) -> str:
    """Why the two slowest poles are neither a conjugate pair nor both real and positive; "" where they are."""
    if poles.size < 2:
        return "the motion has fewer than two poles"
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


def _seen_in(motion: Floats, poles: Complexes) -> tuple[NDArray[np.bool_], Floats]:
    """(which poles the motion has: those without which a sum of modes would fit it clearly worse; the energy of each).

    A fit of a higher order than the motion's has poles that belong to its noise; they may lie anywhere.
    """
    unknown = np.ones(poles.size, bool), np.zeros(poles.size)
    if motion.size < poles.size + 2:
        return unknown
    size, grows = min(motion.size, _LOOKED_AT), np.abs(poles) > 1.0
    # Where the motion is counted from is not certain to the last count: what a constant explains is no mode.
    modes = np.ones((poles.size + 2, size), complex)
    ratios = poles.copy()
    ratios[grows] = 1.0 / poles[grows]
    modes[:-2, 1:] = ratios[:, None]
    np.multiply.accumulate(modes[:-2], axis=1, out=modes[:-2])
    modes[:-2][grows] = modes[:-2][grows, ::-1]  # a growing mode is written backwards from its end: no power overflows
    modes[:-1] /= np.linalg.norm(modes[:-1], axis=1)[:, None]
    modes[-1] = motion[:size]
    factor = np.asarray(np.linalg.qr(modes.T, mode="r"))
    r, left = factor[:-1, :-1], factor[-1, -1]
    if np.min(np.abs(np.diag(r))) < 1e-15:
        return unknown
    inverse = np.linalg.inv(r)
    energy = np.abs(inverse @ factor[:-1, -1]) ** 2
    worse = energy / np.sum(np.abs(inverse) ** 2, axis=1)
    return np.asarray(worse > _CLEARLY * np.abs(left) ** 2 / size)[:-1], energy[:-1]


def _spread_of_sum_and_product(fit: Fit, total: float, product: float, rest: Complexes) -> Floats:
    """To first order: A = Q R, so dA = R dQ + Q dR, a linear system for dQ (and dR) with dA's coefficients known."""
    others = np.real(np.poly(rest)) if rest.size else np.array([1.0])
    system = np.zeros((fit.order, fit.order))
    system[: others.size, 0] = -others  # by the sum: -z R
    system[1 : 1 + others.size, 1] = others  # by the product: R
    for i in range(fit.order - 2):
        system[i : i + 3, 2 + i] = 1.0, -total, product
    sensitivity = np.linalg.solve(system, fit.directions.T)[:2]
    return np.asarray(sensitivity @ fit.spread)


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
