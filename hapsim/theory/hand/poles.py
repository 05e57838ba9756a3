"""Poles of the closed loop: the roots of its characteristic polynomial, and the pair that moves the hand.

For a loop of few poles by real quadratic factors, for thousands of (K, B) at once; for a loop of many, and where two
factors do not come apart, as eigenvalues.

Everything here is in the normalised units kappa = K T²/m and beta = B T/m (see ``loop_equation.py``), arrays of one
shape.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Bools, Complexes, Floats, sort_by_modulus
from hapsim.theory.hand.factors import Roots, divided, in_z, quadratic_factors, roots_of_factors, slow_factor
from hapsim.theory.hand.loop_equation import LoopEquation, characteristic, characteristic_in_w, equation_on_pair
from hapsim.theory.hand.pole_pair import PolePair

POLISH_STEPS = 8
POLISH_DONE = 1e-11  # relative size of a step
POLISH_ACCEPTED = 1e-6  # the same: close to a further pole the last digits do not settle
POLISH_MAY_MOVE = 1e-5  # eigenvalues are better than that: who goes further goes to another pair
MOST_BY_FACTORS = 8  # poles: beyond, powers of w are no good basis
FREE_MASS = 1e-40  # a p or q smaller than this is zero


class Leading(NamedTuple):
    """The slowest-decaying pair as w² + p w + q, and whether it alone moves the hand."""

    p: Floats
    q: Floats
    dominant: Bools


def leading(equation: LoopEquation, kappa: Floats, beta: Floats) -> Leading:
    """The pair that leads loops of one shape, for kappa and beta (n,).

    Mostly it is the first factor that is found, and one look at the others tells that they decay faster.
    """
    if equation.degree > MOST_BY_FACTORS:
        return _solve(equation, kappa, beta)[0]
    coefficients = characteristic_in_w(equation, kappa, beta)
    p, q, found = (
        slow_factor(coefficients)
        if equation.degree > 2
        else (coefficients[1], coefficients[0], np.isfinite(sum(coefficients)))
    )
    pair, further = PolePair(p, q), divided(coefficients, p, q)[2:]
    is_pair = pair.swings | ((1.0 - p + q > 0.0) & (p < 2.0))  # conjugates, or two positive poles
    leads = found & is_pair & all_within(in_z(further), pair.smaller_modulus)
    missed = np.flatnonzero(~leads)
    if missed.size:
        split = _surely_split(PolePair(p[missed], q[missed]), [coefficient[missed] for coefficient in further])
        missed = missed[~(found[missed] & split)]
    if missed.size:
        lead, _ = _solve(equation, kappa[missed], beta[missed], (p[missed], q[missed], found[missed]))
        p[missed], q[missed], leads[missed] = lead
    return Leading(p, q, leads)


def _surely_split(pair: PolePair, further: list[Floats]) -> Bools:
    """Whether a real pole leads alone: the pair does not, and no other two could. Not all cases, but the common ones.

    ``further``: the polynomial of the other poles, in w.
    """
    if len(further) == 2:
        return np.asarray(pair.swings)
    if len(further) != 3:
        return np.zeros(pair.p.shape, dtype=bool)
    others = PolePair(further[1], further[0])
    return np.asarray(~pair.swings & others.swings & (others.larger_modulus < pair.larger_modulus))


def all_poles(equation: LoopEquation, kappa: Floats, beta: Floats) -> tuple[Leading, Complexes]:
    """The same, and all poles (n, N) by decreasing modulus, the leading pair among them as it was found."""
    lead, roots_of_all = _solve(equation, kappa, beta)
    if isinstance(roots_of_all, Roots):
        poles = sort_by_modulus((1.0 + roots_of_all.real + 1j * roots_of_all.imaginary).T)
    else:
        poles = roots_of_all
    poles[:, :2] = np.where(lead.dominant[:, None], PolePair(lead.p, lead.q).poles, poles[:, :2])
    return lead, sort_by_modulus(poles)


def _solve(
    equation: LoopEquation, kappa: Floats, beta: Floats, known: tuple[Floats, Floats, Bools] | None = None
) -> tuple[Leading, Roots | Complexes]:
    if equation.degree > MOST_BY_FACTORS:
        return _by_eigenvalues(equation, kappa, beta)
    factors = quadratic_factors(characteristic_in_w(equation, kappa, beta), known)
    found = roots_of_factors(factors)
    lead = _leading_of(found)
    missed = np.flatnonzero(~factors.found)
    if missed.size:
        (lead.p[missed], lead.q[missed], lead.dominant[missed]), poles = _by_eigenvalues(
            equation, kappa[missed], beta[missed]
        )
        found.real[:, missed], found.imaginary[:, missed] = poles.real.T - 1.0, poles.imag.T
    return lead, found


def _by_eigenvalues(equation: LoopEquation, kappa: Floats, beta: Floats) -> tuple[Leading, Complexes]:
    poles = roots(np.stack(characteristic(equation, kappa, beta), axis=-1))
    return leading_pair(equation, kappa, beta, poles), poles


def _leading_of(roots: Roots) -> Leading:
    """The pair among roots of quadratic factors, which stand conjugate beside conjugate."""
    real, imaginary = roots
    modulus = (1.0 + real) ** 2 + imaginary**2
    points = np.arange(real.shape[1])
    places, moduli = [], []
    for _ in range(2):
        place = np.argmax(modulus, axis=0)
        places.append(place)
        moduli.append(modulus[place, points])
        modulus[place, points] = -1.0
    (a, b), (c, d) = [(real[place, points], imaginary[place, points]) for place in places]
    conjugates = (b != 0.0) & (c == a) & (d == -b)
    positive = (b == 0.0) & (d == 0.0) & (a > -1.0) & (c > -1.0)
    dominant = (conjugates | positive) & (modulus.max(axis=0) < moduli[1])
    return Leading(-(a + c), a * c - b * d, dominant)


def roots(coefficients: Floats) -> Complexes:
    """Roots (..., N) of monic polynomials (..., N + 1), the largest modulus first; NaN where not finite."""
    degree = coefficients.shape[-1] - 1
    finite = np.isfinite(coefficients).all(axis=-1, keepdims=True)
    companion = np.zeros((*coefficients.shape[:-1], degree, degree))
    companion[..., 0, :] = np.where(finite, -coefficients[..., 1:], 0.0)
    below = np.arange(degree - 1)
    companion[..., below + 1, below] = 1.0
    found = sort_by_modulus(np.linalg.eigvals(companion).astype(complex))
    return np.where(finite, found, np.nan)


def leading_pair(equation: LoopEquation, kappa: Floats, beta: Floats, poles: Complexes) -> Leading:
    """The pair of the two slowest poles, polished, from all the poles (..., N) by decreasing modulus."""
    p, q, is_pair = _two_slowest(poles)
    others = poles[..., 2:]
    p, q = _polished(equation, kappa, beta, (p, q), others)
    return Leading(p, q, is_pair & _decay_faster(others, PolePair(p, q)))


def pair_of_poles(poles: Complexes) -> Leading:
    """The same, as they are: of a loop that has no ``LoopEquation``."""
    p, q, is_pair = _two_slowest(poles)
    return Leading(p, q, is_pair & _decay_faster(poles[..., 2:], PolePair(p, q)))


def _two_slowest(poles: Complexes) -> tuple[Floats, Floats, Bools]:
    """(p, q) of the two slowest poles, and whether they are conjugates, or two positive ones."""
    first, second = poles[..., 0], poles[..., 1]
    conjugates = (first.imag != 0.0) & (second == first.conj())
    positive = (first.imag == 0.0) & (second.imag == 0.0) & (first.real > 0.0) & (second.real > 0.0)
    return 2.0 - (first + second).real, ((1.0 - first) * (1.0 - second)).real, conjugates | positive


def _decay_faster(others: Complexes, pair: PolePair) -> Bools:
    return np.asarray(np.abs(others).max(axis=-1, initial=0.0) < pair.smaller_modulus)


def _polished(
    equation: LoopEquation, kappa: Floats, beta: Floats, start: tuple[Floats, Floats], others: Complexes
) -> tuple[Floats, Floats]:
    """Newton's method on the quadratic factor of the pair; the start, where it does not converge nearby.

    The characteristic polynomial is (w² + p w + q) H(w) at the solution, and the other poles tell H well
    enough: the polynomial on the present pair, divided by H, is the change of p w + q.
    """
    p, q = start
    for _ in range(POLISH_STEPS):
        w = PolePair(p, q).w
        change = equation_on_pair(equation, kappa, beta, w)
        for pole in np.moveaxis(others, -1, 0):
            change = change.over(w.plus(1.0 - pole))
        dp, dq = np.real(change.slope), np.real(change.constant)
        p, q = p + dp, q + dq
        step = np.maximum(
            np.abs(dp) / (np.abs(p) + np.sqrt(np.abs(q)) + FREE_MASS), np.abs(dq) / (np.abs(q) + FREE_MASS)
        )
        if not (step > POLISH_DONE).any():
            break
    moved = np.abs(p - start[0]) + np.abs(q - start[1])
    good = (step <= POLISH_ACCEPTED) & (moved <= POLISH_MAY_MOVE)
    return np.where(good, p, start[0]), np.where(good, q, start[1])


def all_within(coefficients: list[Floats], radius: Floats) -> Bools:
    """Whether all roots of polynomials in z, highest power first, have a modulus below the radius, by Jury's test."""
    shrink = 1.0 / radius
    remaining, scale = [coefficients[0]], shrink
    for coefficient in coefficients[1:]:
        remaining.append(coefficient * scale)
        scale = scale * shrink
    inside = np.ones(radius.shape, dtype=bool)
    while len(remaining) > 1:
        ratio = remaining[-1] / remaining[0]
        inside &= np.abs(ratio) < 1.0
        turned = remaining[::-1]
        remaining = [one - ratio * other for one, other in zip(remaining[:-1], turned[:-1], strict=True)]
    return inside


def without_pair(coefficients: list[Floats], pair: PolePair) -> list[Floats]:
    """Monic polynomials in z, highest power first, divided by the pair's factor."""
    return divided(coefficients[::-1], pair.p - 2.0, 1.0 - pair.p + pair.q)[:1:-1]
