"""Poles of the closed loop: the roots of its characteristic polynomial, and the pair that moves the hand.

All roots are computed as eigenvalues. Newton's method then refines the two slowest as one quadratic factor, the one
whose element is the given one; slow poles and poles that meet keep their digits in it. Units are normalised, kappa = K
T²/m and beta = B T/m (see ``lone_hand.py``), in arrays of one shape.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from inspect import signature
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Complexes, Floats, sort_by_modulus
from hapsim.theory.hand.lone_hand import Driven, LoneHand, characteristic, element_of_relation, relation_on_pair
from hapsim.theory.hand.pole_pair import PolePair
from hapsim.theory.network.felt import MEMORY, UNLIKE, unlike

POLISH_STEPS = 8
POLISH_DONE = 1e-9  # relative size of a step: Newton's next one would change nothing
POLISH_TRIES = 1e-5  # relative change of the pair in a difference quotient
POLISH_ACCEPTED = 1e-6  # relative size of the last step: close to another pole the last digits do not settle
POLISH_MAY_MOVE = 1e-5  # eigenvalues are more accurate: a larger step leads to another pair
FREE_MASS = 1e-40  # a p or q smaller than this is zero
POINTS_AT_ONCE = 32768  # block of large arrays: this number fits a core's cache


def broadcast_in_blocks(method: Callable[..., Any]) -> Callable[..., Any]:
    """Decorates a method that treats each pair of entries of two arrays (n,) separately: it accepts arrays of any
    shapes. The arrays are broadcast against each other, and the results have their shape; scalars give scalars. Numbers
    out of range become NaN, without a warning."""
    takes = signature(method)

    @wraps(method)
    def whole(*args: Any, **named: Any) -> Any:
        (itself, *values), named = (bound := takes.bind(*args, **named)).args, bound.kwargs
        one, other = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in values))
        blocks = [
            (one.ravel()[at : at + POINTS_AT_ONCE], other.ravel()[at : at + POINTS_AT_ONCE])
            for at in range(0, max(one.size, 1), POINTS_AT_ONCE)
        ]
        with np.errstate(all="ignore"):
            results = [method(itself, *block, **named) for block in blocks]
        tuples = isinstance(results[0], tuple)
        columns = [np.concatenate(column) for column in (zip(*results, strict=True) if tuples else [results])]
        shaped = tuple(column.reshape(one.shape + column.shape[1:])[()] for column in columns)
        return shaped if tuples else shaped[0]

    return whole


class LeadingPair(NamedTuple):
    """Slowest-decaying pair as w² + p w + q, and whether it alone moves the hand."""

    p: Floats
    q: Floats
    dominant: Bools


def all_poles(hand: LoneHand, kappa: Floats, beta: Floats) -> tuple[LeadingPair, Complexes]:
    """Leading pair for kappa and beta (n,), and all poles (n, N) by decreasing modulus."""
    if hand.driven is not None:
        return _driven_poles(hand, hand.driven, kappa, beta)
    poles = roots(np.stack(characteristic(hand, kappa, beta), axis=-1))
    p, q, is_pair = _two_slowest(poles)
    others = poles[:, 2:]
    p, q = _polished(hand, kappa, beta, (p, q))
    pair = PolePair(p, q)
    lead = LeadingPair(p, q, is_pair & _decay_faster(others, pair))
    poles[:, :2] = np.where(lead.dominant[:, None], sort_by_modulus(pair.poles), poles[:, :2])
    return lead, poles


def _driven_poles(hand: LoneHand, driven: Driven, kappa: Floats, beta: Floats) -> tuple[LeadingPair, Complexes]:
    """Returns the same of a hand behind a drive. Its pair is that of the two slowest motions, as that of a network: it
    moves the hand if the handle answers an impulse as the mass on this spring and damper does."""
    finite = np.isfinite(kappa + beta)
    element = np.where(finite, [kappa, beta - hand.lag * kappa], 0.0).T @ hand.reads
    found = np.linalg.eig(hand.change - hand.push[:, None] * element[:, None, :])
    w, states = (np.asarray(one, complex) for one in found)
    z, lasts = np.asarray(1.0 + w, complex), np.abs(1.0 + w) > MEMORY
    s = np.asarray(np.log1p(np.where(lasts, w, 0.0)), complex)
    own = np.argsort(np.where(lasts, np.abs(s), np.inf), axis=-1, kind="stable")[:, :2]
    p, q, is_pair = _two_slowest(np.take_along_axis(z, own, axis=-1))
    p, q = _polished(hand, kappa, beta, (p, q))
    try:
        amounts = np.linalg.solve(states, np.broadcast_to(driven.kick[:, None] + 0j, (*w.shape, 1)))[..., 0]
    except np.linalg.LinAlgError:
        amounts = np.linalg.pinv(states) @ driven.kick
    answers = np.where(lasts, (driven.handle @ states) * amounts, 0.0)
    of_pair = np.asarray(np.log(PolePair(p, q).poles), complex)
    apart = 1.0 / (of_pair[:, 0] - of_pair[:, 1])
    differs = unlike(s, answers[:, None], of_pair, np.stack([apart, -apart], axis=-1)[:, None])
    poles = np.where(finite[:, None], sort_by_modulus(z), np.nan)
    return LeadingPair(p, q, finite & is_pair & (differs <= UNLIKE)), poles


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


def pair_of_poles(poles: Complexes) -> LeadingPair:
    """Leading pair of poles (..., N) by decreasing modulus, without refinement: for a loop without a ``LoneHand``."""
    p, q, is_pair = _two_slowest(poles)
    return LeadingPair(p, q, is_pair & _decay_faster(poles[..., 2:], PolePair(p, q)))


def _two_slowest(poles: Complexes) -> tuple[Floats, Floats, Bools]:
    """Coefficients (p, q) of the two slowest poles, and whether they are conjugates, or two positive ones."""
    first, second = poles[..., 0], poles[..., 1]
    conjugates = (first.imag != 0.0) & (second == first.conj())
    positive = (first.imag == 0.0) & (second.imag == 0.0) & (first.real > 0.0) & (second.real > 0.0)
    return 2.0 - (first + second).real, ((1.0 - first) * (1.0 - second)).real, conjugates | positive


def _decay_faster(others: Complexes, pair: PolePair) -> Bools:
    return np.asarray(np.abs(others).max(axis=-1, initial=0.0) < pair.smaller_modulus)


def _polished(hand: LoneHand, kappa: Floats, beta: Floats, start: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Returns (p, q) by Newton's method on the map from the pair to its element, or the start if this does not converge
    nearby."""
    p, q, step = start[0].copy(), start[1].copy(), np.full(start[0].shape, np.inf)
    some = np.arange(p.size)  # entries that still iterate; the others keep their results
    for _ in range(POLISH_STEPS):
        size_p = np.abs(p[some]) + np.sqrt(np.abs(q[some])) + FREE_MASS
        size_q = np.abs(q[some]) + FREE_MASS
        dp, dq = _newton_step(
            hand, (kappa[some], beta[some]), p[some], q[some], POLISH_TRIES * np.stack([size_p, size_q])
        )
        p[some] += dp
        q[some] += dq
        step[some] = np.maximum(np.abs(dp) / size_p, np.abs(dq) / size_q)
        some = some[step[some] > POLISH_DONE]
        if not some.size:
            break
    moved = np.abs(p - start[0]) + np.abs(q - start[1])
    good = (step <= POLISH_ACCEPTED) & (moved <= POLISH_MAY_MOVE)
    return np.where(good, p, start[0]), np.where(good, q, start[1])


def _newton_step(hand: LoneHand, element: tuple[Floats, Floats], p: Floats, q: Floats, tries: Floats) -> Floats:
    """Returns the changes of p and of q that make the pair's element the given one."""
    several_p, several_q = np.stack([p, p + tries[0], p]), np.stack([q, q, q + tries[1]])
    tries = np.stack([several_p[1] - p, several_q[2] - q])
    relation = relation_on_pair(hand, PolePair(several_p, several_q), (hand.p - several_p, hand.q - several_q))
    found = element_of_relation(hand, relation)
    (a, b), (c, d) = ((of[1:] - of[0]) / tries for of in found)
    more_kappa, more_beta = element[0] - found[0][0], element[1] - found[1][0]
    return np.stack([d * more_kappa - b * more_beta, a * more_beta - c * more_kappa]) / (a * d - b * c)


def all_within(coefficients: list[Floats], radius: Floats) -> Bools:
    """Returns whether all roots of polynomials in z, highest power first, are within the radius (Jury's test)."""
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
    """Returns monic polynomials in z, highest power first, divided by the pair's factor z² + (p - 2) z + 1 - p + q."""
    linear, constant = pair.p - 2.0, 1.0 - pair.p + pair.q
    quotient = [coefficients[0], coefficients[1] - linear]
    for coefficient in coefficients[2:-2]:
        quotient.append(coefficient - linear * quotient[-1] - constant * quotient[-2])
    return quotient[: len(coefficients) - 2]


# Reasons why no k and b exist.

NOT_FINITE = "a value is not finite, or out of the range of the computation"
NEGATIVE = "the slowest motion changes its sign with every sample; no spring and damper does this"
SINGLE = "the slowest motion creeps and the next one oscillates; no spring and damper does both"
UNLIKE_PAIR = "it answers a push otherwise than a spring and a damper would"
FURTHER = "another pole of the loop decays no faster than the pair of the hand"
OWN_ABOVE_NYQUIST = "the device's own mass and spring oscillate at or above the Nyquist frequency, half the rate"


def dominance_reasons(poles: Complexes, dominant: Bools) -> NDArray[np.str_]:
    """Reasons for poles (..., N) by decreasing modulus; "" where the pair is dominant."""
    first, second = poles[..., 0], poles[..., 1]
    real = first.imag == 0.0
    conjugates = ~real & (second == first.conj())
    cases = [
        (dominant, ""),
        (~np.isfinite(poles).all(axis=-1), NOT_FINITE),
        (conjugates, FURTHER),
        (real & (first.real <= 0.0), NEGATIVE),
        (real & (second.imag == 0.0) & (second.real > 0.0), FURTHER),
        (real, SINGLE),
    ]
    return np.select([case for case, _ in cases], [words for _, words in cases], FURTHER)
