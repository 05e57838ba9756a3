"""The loop around a lone hand on an element (K, B), out of the rows of a sample (``theory/sample.py``).

In normalised units: kappa = K T²/m, beta = B T/m, times in sample periods, w = z - 1. The hand is moved by the force
-(kappa y + beta v) of its reading y and of its damper's v; both are rows of the state, so the loop is linear in kappa
and beta (Florens et al., §6). Of a spring that acts ``lag`` samples later than the damper, the backward difference
takes kappa lag from beta.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.dampers import DamperModel
from hapsim.theory.arrays import Floats
from hapsim.theory.hand.pole_pair import LinearOnPair, PolePair, quadratic_of_oscillator, total
from hapsim.theory.network.network import Network
from hapsim.theory.rows import cut
from hapsim.theory.sample import loop, sizes_of

UNFELT = 2.0**-300  # a damping: a damper without one has no memories, and beside this one all numbers stay as they are
NOTHING = 2e-14  # of a polynomial's largest coefficient: the rounding of what is zero

Relation = tuple[LinearOnPair, LinearOnPair]


class LoneHand(NamedTuple):
    """The loop without the element: ``change`` (n, n) of the state, ``push`` (n,) of a force, ``reads`` (2, n) of y and
    of v.

    ``moving``: where in the state position and velocity are, which without forces move by the factor w² + p w + q.
    The other places, of which each reads those before it alone: the ``held`` forces, the newest first, what
    ``averaged`` sampling remembers, the ``way`` of the reading since the last sample, and what the damper remembers.
    ``numerator``, ``lead``: a force f is read as y = f numerator(z)/(z^lead (w² + p w + q)).
    ``polynomials`` (3, N + 1): of the characteristic one, in z, highest power first, what does not depend on the
    element, and the factors of kappa and beta.
    """

    damping: float
    stiffness: float
    lag: float
    damper: DamperModel
    p: float
    q: float
    change: Floats
    push: Floats
    reads: Floats
    moving: tuple[int, int]
    held: list[int]
    averaged: list[int]
    way: int
    memories: list[int]
    numerator: Floats
    lead: int
    polynomials: Floats

    @property
    def degree(self) -> int:
        """Number of poles."""
        return self.polynomials.shape[1] - 1


@lru_cache(maxsize=256)
def lone_hand(
    damping: float, stiffness: float, delay: float, hold: str, sampling: str, damper: DamperModel, lag: float
) -> LoneHand:
    """The loop of a normalised real friction b0 T/m and spring k0 T²/m."""
    one = np.ones(1)
    network = Network(
        1.0, one, damping * one, delay, hold, sampling, one[:0], np.array([[0, -1]]), 0.0 * one, UNFELT * one,
        stiffness * one, (damper,),
    )  # fmt: skip
    found, sizes = loop(network, inputs=True), sizes_of(network)
    parts = cut(np.arange(len(found.change)), sizes)
    push, reads = found.push[:, 0], np.concatenate(found.stretches)
    change = found.change + UNFELT * np.outer(push, reads[1])
    (x,), (v,), (way,) = (parts[name].tolist() for name in ("position", "velocity", "way"))
    read = list(np.flatnonzero(reads.any(axis=0)))
    for row in read:  # and what is read for them, while the list grows
        read += [at for at in np.flatnonzero(change[row]) if at not in read]
    held, averaged, memories = (
        [at for name in names for at in parts[name].tolist() if at in read]
        for names in (["held"], ["lag", "mean_velocity"], ["older", "past"])
    )
    p, q = quadratic_of_oscillator(damping, stiffness)
    free = np.array([1.0, p - 2.0, 1.0 - p + q])
    seen = [x, v, *held, *averaged]
    numerator = _polynomials(free, change, push, reads[:1], seen)[1]
    first, last = np.flatnonzero(numerator)[[0, -1]].tolist()
    polynomials = _polynomials(free, change, push, reads, [*seen, *[way] * (way in read), *memories])
    polynomials = polynomials[:, : np.flatnonzero(polynomials.any(axis=0))[-1] + 1]  # no motion shows the rest
    of_reading = numerator[first : last + 1], last - 2
    own = damping, stiffness, lag, damper, p, q
    return LoneHand(*own, change, push, reads, (x, v), held, averaged, way, memories, *of_reading, polynomials)


def _polynomials(free: Floats, change: Floats, push: Floats, reads: Floats, state: list[int]) -> Floats:
    """(1 + R, N + 1), in z, of some of the ``state``, position and velocity first: det(z - M), M = 1 + change, of which
    all that is remembered is a factor by itself; and that times what is read of (z - M)⁻¹ push."""
    change, push, reads = change[np.ix_(state, state)], push[state], reads[:, state]
    whole, moved = np.convolve(free, np.poly(1.0 + np.diag(change)[2:])), push
    columns = [push]
    for coefficient in whole[1:-1]:
        moved = moved + change @ moved + coefficient * push
        columns.append(moved)
    found = reads @ np.array(columns).T
    found[np.abs(found) <= NOTHING * np.abs(found).max(axis=1, keepdims=True)] = 0.0
    return np.vstack([whole, np.column_stack([np.zeros(len(reads)), found])])


def characteristic(hand: LoneHand, kappa: Floats, beta: Floats) -> list[Floats]:
    """The monic characteristic polynomial in z, highest power first, one array for each coefficient."""
    beta = beta - hand.lag * kappa
    return [constant + of_kappa * kappa + of_beta * beta for constant, of_kappa, of_beta in hand.polynomials.T.tolist()]


def relation_on_pair(hand: LoneHand, pair: PolePair, change: tuple[Floats, Floats]) -> Relation:
    """(H, r) on a pair of poles: there the equation is kappa + beta H + r = 0.

    ``change``: (p, q) of the mass by itself less those of the pair: on it w² + p w + q is the line of these two.
    """
    w, z, free = pair.w, pair.w.plus(1.0), LinearOnPair(change[1], change[0], pair)
    numerator = z.polynomial(hand.numerator)
    if hand.lead < 0:
        ratio = w.power(0).over(z.power(-hand.lead).times(numerator))
    else:
        ratio = z.power(hand.lead).over(numerator)
    # All that a damper remembers is taken for a reading of 1: it knows nothing of how the mass came there.
    values = _sensed(hand, pair, free) if hand.damper.senses else {}
    values[hand.way] = w.over(z)
    for at in hand.memories:
        values[at] = _sum(hand.change[at], values).over(w.plus(-float(hand.change[at, at])))
    return _sum(hand.reads[1], values), free.times(ratio)


def _sum(row: Floats, values: dict[int, LinearOnPair]) -> LinearOnPair:
    return total([value.scaled(float(row[at])) for at, value in values.items() if row[at]])


def _sensed(hand: LoneHand, pair: PolePair, free: LinearOnPair) -> dict[int, LinearOnPair]:
    """The velocities, for a reading of 1.

    First for a force that moves the mass by 1, times z for every sample that it is remembered: so nothing is divided by
    what may be nearly zero.
    """
    w, z, (x, v), rows = pair.w, pair.w.plus(1.0), hand.moving, np.column_stack([hand.change, hand.push])
    forces = dict(zip([len(rows), *hand.held], [z.power(age) for age in range(len(hand.held), -1, -1)], strict=True))
    of_x, of_v = _sum(rows[x], forces), _sum(rows[v], forces)
    values = {at: value.times(free) for at, value in forces.items()}
    values[x] = total([w.plus(-float(rows[v, v])).times(of_x), of_v.scaled(float(rows[x, v]))])
    values[v] = total([of_x.scaled(float(rows[v, x])), w.plus(-float(rows[x, x])).times(of_v)])
    if hand.averaged:
        averaged = {at: _sum(rows[at], values) for at in hand.averaged}
        values = {at: value.times(z) for at, value in values.items()} | averaged
    reads = np.column_stack([hand.reads, np.zeros(2)])
    y = _sum(reads[0], values)
    return {at: value.over(y) for at, value in values.items() if reads[1, at]}


def element_of_relation(hand: LoneHand, relation: Relation) -> tuple[Floats, Floats]:
    """(kappa, beta) that put the pair in place; not finite where they cannot tell its two poles apart."""
    (H, H_slope, _), (r, r_slope, _) = relation
    beta = -r_slope / H_slope
    kappa = -(r + beta * H)
    return kappa, beta + hand.lag * kappa
