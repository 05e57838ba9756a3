"""Poles of the closed loop: the characteristic polynomial, its roots, and the pair that moves the hand.

Everything here is in the normalised units kappa = K T²/m and beta = B T/m (see ``plant.py``), arrays of one
shape.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Bools, Complexes, Floats
from hapsim.theory.pair import OnPair, constant_like, pair_of_quadratic
from hapsim.theory.plant import Plant

POLISH_STEPS = 8
POLISH_DONE = 1e-11  # relative size of a step
POLISH_ACCEPTED = 1e-6  # the same: close to a further pole the last digits do not settle
POLISH_MAY_MOVE = 1e-5  # eigenvalues are better than that: who goes further goes to another pair
FREE_MASS = 1e-40  # a p or q smaller than this is zero


class Leading(NamedTuple):
    """The slowest-decaying pair as w² + p w + q, and whether it alone moves the hand."""

    p: Floats
    q: Floats
    dominant: Bools


def characteristic(plant: Plant, kappa: Floats, beta: Floats) -> Floats:
    """Coefficients (..., N + 1) of the monic characteristic polynomial in z, highest power first."""
    coefficients = np.zeros((*kappa.shape, plant.order + 3))
    # z^order (z - 1)(z - exp(-b0 T/m))
    coefficients[..., :3] = [1.0, plant.decay - 2.0, 1.0 - plant.decay]
    count = plant.numerator.size
    element = np.stack([kappa + beta, -beta], axis=-1)
    for lead in (0, 1):
        start = plant.order + 3 - count - 1 + lead
        coefficients[..., start : start + count] += element[..., lead, None] * plant.numerator
    return coefficients


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


def sort_by_modulus(values: Complexes) -> Complexes:
    """Along the last axis, by decreasing modulus; conjugates together, the one above the real axis first."""
    order = np.lexsort((-values.imag, -values.real, -np.abs(values)), axis=-1)
    return np.take_along_axis(values, order, axis=-1)


def leading_pair(plant: Plant, kappa: Floats, beta: Floats, poles: Complexes) -> Leading:
    """The pair of the two slowest poles, polished, from all the poles (..., N) by decreasing modulus."""
    first, second, others = poles[..., 0], poles[..., 1], poles[..., 2:]
    p = 2.0 - (first + second).real
    q = ((1.0 - first) * (1.0 - second)).real
    conjugates = (first.imag != 0.0) & (second == first.conj())
    positive = (first.imag == 0.0) & (second.imag == 0.0) & (first.real > 0.0) & (second.real > 0.0)
    is_pair = conjugates | positive
    p, q = _polished(plant, kappa, beta, (p, q), others)

    w = pair_of_quadratic(p, q)
    slower_than = np.minimum(np.abs(1.0 + w.near), np.abs(1.0 + w.far))
    dominant = is_pair & (np.abs(others).max(axis=-1, initial=0.0) < slower_than)
    return Leading(p, q, dominant)


def _polished(
    plant: Plant, kappa: Floats, beta: Floats, start: tuple[Floats, Floats], others: Complexes
) -> tuple[Floats, Floats]:
    """Newton's method on the quadratic factor of the pair; the start, where it does not converge nearby.

    The characteristic polynomial is (w² + p w + q) H(w) at the solution, and the other poles tell H well
    enough: the polynomial on the present pair, divided by H, is the change of p w + q.
    """
    p, q = start
    for _ in range(POLISH_STEPS):
        w = pair_of_quadratic(p, q)
        change = _characteristic_on(plant, kappa, beta, w)
        for pole in np.moveaxis(others, -1, 0):
            change = change.over(w.plus(1.0 - pole))
        dp = change.slope.real
        dq = (change.near - dp * w.near).real
        p, q = p + dp, q + dq
        step = np.maximum(
            np.abs(dp) / (np.abs(p) + np.sqrt(np.abs(q)) + FREE_MASS), np.abs(dq) / (np.abs(q) + FREE_MASS)
        )
        if not (step > POLISH_DONE).any():
            break
    moved = np.abs(p - start[0]) + np.abs(q - start[1])
    good = (step <= POLISH_ACCEPTED) & (moved <= POLISH_MAY_MOVE)
    return np.where(good, p, start[0]), np.where(good, q, start[1])


def _characteristic_on(plant: Plant, kappa: Floats, beta: Floats, w: OnPair) -> OnPair:
    """The characteristic polynomial, in terms of w and z = 1 + w.

    Ordered by powers of w, so that what friction and simulated damping leave of each other is one sum,
    b0 T/m + beta, and not the difference of two polynomials.
    """
    z = w.plus(1.0)
    sums = np.cumsum(plant.numerator)  # numerator(z) = w · polynomial of all sums but the last + the last
    free = z.polynomial(np.array([1.0] + [plant.decay] * plant.order))
    terms = [w.times(w).times(free), z.times(z.polynomial(plant.numerator)).times(constant_like(w, kappa))]
    if sums.size > 1:
        terms.append(w.times(w).times(z.polynomial(sums[:-1])).times(constant_like(w, beta)))
    terms.append(w.times(constant_like(w, sums[-1] * (plant.damping + beta))))
    return OnPair(*(sum(parts) for parts in zip(*terms, strict=True)))


def all_within(coefficients: Floats, radius: Floats) -> Bools:
    """Whether all roots of the polynomials (..., N + 1) have a modulus below the radius, by Jury's test."""
    degree = coefficients.shape[-1] - 1
    remaining = coefficients / radius[..., None] ** np.arange(degree + 1)
    inside = np.ones(radius.shape, dtype=bool)
    while remaining.shape[-1] > 1:
        ratio = remaining[..., -1:] / remaining[..., :1]
        inside &= np.abs(ratio[..., 0]) < 1.0
        remaining = (remaining - ratio * remaining[..., ::-1])[..., :-1]
    return inside


def without_pair(coefficients: Floats, w: OnPair) -> Floats:
    """The monic polynomials (..., N + 1) divided by (z - 1 - w.near)(z - 1 - w.far): (..., N - 1)."""
    minus_sum = -(2.0 + w.near + w.far).real
    product = ((1.0 + w.near) * (1.0 + w.far)).real
    quotient = coefficients[..., :-2].copy()
    for i in range(1, quotient.shape[-1]):
        quotient[..., i] -= minus_sum * quotient[..., i - 1]
        if i > 1:
            quotient[..., i] -= product * quotient[..., i - 2]
    return quotient
