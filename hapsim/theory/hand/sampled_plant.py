"""The real mass as the computer sees it: G(z) = Y(z)/f(z), by the modified z-transform.

Time in sample periods, force as T²/m f. With w = z - 1 and delay = D + fraction, the mass with its friction and its
spring, if it has one, moves freely by the factor w² + p w + q, and

    1/G(z) = z^lead (w² + p w + q) / numerator(z),       lead = D - 1 + degree of the numerator

The velocity that the device senses is a second output; of the position that it senses too it is

    V(z)/Y(z) = w velocity(z) / (z numerator(z)) + offset

``offset`` is what it reads at rest: nothing, except where a force that is not level, such as impulses, keeps a spring
in its place.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hapsim.holds import HOLDS, Term
from hapsim.theory.arrays import Floats
from hapsim.theory.hand.pole_pair import quadratic_of_oscillator
from hapsim.theory.interface import SAMPLINGS, product, whole_and_fraction

NOTHING = 1e-13  # of the largest coefficient: the rounding of what is zero
VELOCITY, POSITION, AREA, DOUBLE_AREA, TRIPLE_AREA = range(5)
TAYLOR_TERMS = 20  # where friction and spring turn the motion by less than a half: beyond rounding


class SampledPlant(NamedTuple):
    """``damping`` is b0 T/m, ``stiffness`` k0 T²/m; polynomials in powers of z, highest first."""

    damping: float
    stiffness: float
    p: float
    q: float
    numerator: Floats
    lead: int
    velocity: Floats
    offset: float


def sampled_plant(damping: float, stiffness: float, delay: float, hold: str, sampling: str) -> SampledPlant:
    """The plant of a normalised real friction b0 T/m and spring k0 T²/m, and a delay in sample periods."""
    whole, fraction = whole_and_fraction(delay)
    terms = product(HOLDS[hold].terms, SAMPLINGS[sampling].terms)
    last, part = whole_and_fraction(max(term.lag for term in terms))
    count = last + math.ceil(part + fraction) + 1  # samples until the mass moves freely
    # One more than the position needs: a blow's velocity is there at once.
    outputs = _readings(terms, damping, stiffness, np.arange(1.0, count + 2.0) - fraction)
    p, q = quadratic_of_oscillator(damping, stiffness)

    # Once the hold and the sampling are over the mass moves freely: the free motion's factor annihilates what it
    # does, and what is left of the product is the numerator.
    free = np.array([1.0, p - 2.0, 1.0 - p + q])
    numerator = np.convolve(outputs[0], free)[:count]
    offset = _reading_at_rest(damping, stiffness, _ripple(terms, fraction))
    velocity = _over_w(np.convolve(outputs[1], free)[: count + 1] - offset * np.append(numerator, 0.0))
    return SampledPlant(damping, stiffness, p, q, numerator, whole + count - 2, velocity, offset)


def _readings(terms: tuple[Term, ...], damping: float, stiffness: float, times: Floats) -> Floats:
    """(2, times): position and velocity that the device reads, ``times`` periods after one computed force came."""
    read = np.zeros((2, times.size))
    for weight, lag, integrations in terms:
        for i in np.flatnonzero(times > lag):
            response = response_to_a_blow(damping, stiffness, times[i] - lag)
            read[0, i] += weight * response[POSITION + integrations]
            read[1, i] += weight * response[VELOCITY + integrations]
    return read


def _ripple(terms: tuple[Term, ...], fraction: float) -> tuple[Term, ...]:
    """What is left of the terms where all computed forces are 1: within a period, each with the time from its beginning
    to the next sample as its lag. Nothing where the force is then 1 throughout."""
    weights: dict[tuple[float, int], float] = {}
    for weight, lag, integrations in terms:
        since = 1.0 - (whole_and_fraction(lag)[1] + fraction) % 1.0
        weights[since, integrations] = weights.get((since, integrations), 0.0) + weight
    return tuple(Term(weight, since, integrations) for (since, integrations), weight in weights.items() if weight)


def _reading_at_rest(damping: float, stiffness: float, ripple: tuple[Term, ...]) -> float:
    """Velocity over position, as read, of a mass that the same ``ripple`` in every period keeps on its spring.

    What one period does to a mass at rest, times (1 - exp(M))⁻¹, in which the integral of exp(M) over a period takes
    the place of 1 - exp(M), so that nothing cancels where the spring is weak.
    """
    if not ripple:
        return 0.0
    period = response_to_a_blow(damping, stiffness, 1.0)
    x = v = 0.0
    forces = _force_at_a_sample(ripple)[: TRIPLE_AREA - POSITION]  # what would come next is 0: a force does not grow
    for order, value in enumerate(forces, start=1):
        x += value * period[POSITION + order]
        v += value * period[VELOCITY + order]
    for weight, since, integrations in ripple:
        response = response_to_a_blow(damping, stiffness, since)
        x += weight * response[POSITION + integrations]
        v += weight * response[VELOCITY + integrations]
    velocity = period[AREA] * v - period[POSITION] * x
    position = period[POSITION] * (v + damping * x) + stiffness * period[AREA] * x
    return float(stiffness * velocity / position)


def _force_at_a_sample(ripple: tuple[Term, ...]) -> list[float]:
    """The force and its derivatives just after a sample: after a period they are the same, and its mean is 1."""
    found: list[float] = []  # the highest first
    for order in reversed(range(1 + max(term.integrations for term in ripple))):
        grown = math.fsum(
            weight * since ** (integrations - order) / math.factorial(integrations - order)
            for weight, since, integrations in ripple
            if integrations >= order
        )
        grown += math.fsum(value / math.factorial(i) for i, value in enumerate(reversed(found), start=2))
        found.append(float(order == 0) - grown)
    return found[::-1]


def _over_w(polynomial: Floats) -> Floats:
    """The polynomial in z, which has a root at z = 1, divided by w = z - 1."""
    sums = np.cumsum(polynomial)[:-1]
    sums[np.abs(sums) < NOTHING * np.abs(sums).max()] = 0.0
    return np.asarray(sums)


def response_to_a_blow(damping: float, stiffness: float, time: float) -> Floats:
    """(5,): velocity, position and its three integrals, ``time`` >= 0 after a unit blow on the mass at rest.

    By the Taylor series of the chain velocity, position and its three integrals, halved until it converges at once and
    then doubled: one code for no friction, hardly any, a spring, critical damping and beyond.

    ``damping``: b0 T/m. ``stiffness``: k0 T²/m.
    """
    chain = np.diag(np.ones(4), -1)
    chain[VELOCITY, [VELOCITY, POSITION]] = -damping, -stiffness
    turn = time * max(damping, math.sqrt(stiffness))
    halvings = max(0, math.ceil(math.log2(2.0 * turn))) if turn > 0.0 else 0
    scaled = chain * (time / 2.0**halvings)
    flow = np.eye(5)
    for n in reversed(range(1, TAYLOR_TERMS + 1)):
        flow = np.eye(5) + scaled @ flow / n
    return np.asarray(np.linalg.matrix_power(flow, 2**halvings)[:, VELOCITY])
