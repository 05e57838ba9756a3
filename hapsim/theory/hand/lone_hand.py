"""Loop around a single hand on an element (K, B), from the rows of a sample (``theory/sample.py``).

In normalised units: kappa = K T²/m, beta = B T/m, times in sample periods, w = z - 1. The force -(kappa y + beta v)
moves the hand, with its reading y and its damper's v. Both are rows of the state, so the loop is linear in kappa and
beta (Florens et al., §6). If a spring acts ``lag`` samples later than the damper, the backward difference subtracts
kappa lag from beta.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hapsim.dampers import DamperModel
from hapsim.theory.arrays import Floats
from hapsim.theory.hand.pole_pair import LinearOnPair, PolePair, quadratic_of_oscillator, total
from hapsim.theory.interface import Ahead
from hapsim.theory.network.network import Network
from hapsim.theory.plant import RIGID, Drive
from hapsim.theory.rows import cut
from hapsim.theory.sample import hand_kicks, hands_of, loop, sizes_of

UNFELT = 2.0**-300  # a tiny damping: a damper without one has no memories, and this one changes no other number
NOTHING = 2e-14  # relative to a polynomial's largest coefficient: rounding of a zero

Relation = tuple[LinearOnPair, LinearOnPair]


class Driven(NamedTuple):
    """Motion of a hand behind a drive, without forces: ``free`` (3 + I,), its factor as a polynomial in w, in place of
    w² + p w + q; ``kick`` (n,), the state after an impulse of m 1 m per sample on the handle; ``handle`` (n,), the row
    of its position."""

    free: Floats
    kick: Floats
    handle: Floats


class LoneHand(NamedTuple):
    """Loop without the element: ``change`` (n, n) of the state, ``push`` (n,) of a force, ``reads`` (2, n) of y and of
    v.

    ``moving``: places of position and velocity in the state; without forces they move by the factor w² + p w + q. Each
    other place reads only those before it: the ``held`` forces, newest first; the memory of ``averaged`` sampling;
    ``last_step`` of the reading; and the memories of the damper. ``numerator``, ``lead``: a force f is read as y =
    f numerator(z)/(z^lead (w² + p w + q)). ``polynomials`` (3, N + 1): parts of the characteristic polynomial in z,
    highest power first: the part that does not depend on the element, and the factors of kappa and beta. ``driven``:
    of a hand behind a drive, whose inner states move with position and velocity; else None.
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
    last_step: int
    memories: list[int]
    numerator: Floats
    lead: int
    polynomials: Floats
    driven: Driven | None

    @property
    def degree(self) -> int:
        """Number of poles."""
        return self.polynomials.shape[1] - 1


@lru_cache(maxsize=256)
def lone_hand(
    damping: float,
    stiffness: float,
    delay: float,
    hold: str,
    sampling: str,
    damper: DamperModel,
    lag: float,
    ahead: Ahead | None = None,
    drive: Drive = RIGID,
) -> LoneHand:
    """Returns the loop of a normalised real friction b0 T/m, spring k0 T²/m and drive; masses in ``ahead`` relative to
    its own."""
    one = np.ones(1)
    network = Network(
        1.0, one, damping * one, delay, hold, sampling, one[:0], np.array([[0, -1]]), 0.0 * one, UNFELT * one,
        stiffness * one, (damper,), ahead=ahead, drives=(drive,) if drive.inner else (),
    )  # fmt: skip
    found, sizes = loop(network, inputs=True), sizes_of(network)
    parts = cut(np.arange(len(found.change)), sizes)
    push, reads = found.push[:, 0], np.concatenate(found.stretches)
    change = found.change + UNFELT * np.outer(push, reads[1])
    (x,), (v,), (last_step,) = (parts[name].tolist() for name in ("position", "velocity", "last_step"))
    read = list(np.flatnonzero(reads.any(axis=0)))
    for row in read:  # and the places that these read, while the list grows
        read += [at for at in np.flatnonzero(change[row]) if at not in read]
    held, averaged, memories = (
        [at for name in names for at in parts[name].tolist() if at in read]
        for names in (["held"], ["lag", "mean_velocity"], ["old_steps", "old_rates"])
    )
    p, q = quadratic_of_oscillator(damping, stiffness)
    free, own, driven = np.array([1.0, p - 2.0, 1.0 - p + q]), [x, v, *parts["inner"].tolist()], None
    if drive.inner:
        w = np.linalg.eigvals(change[np.ix_(own, own)])
        free = np.poly(1.0 + w).real
        (handle,), _, _ = hands_of(network, np.eye(len(change), dtype=complex))
        driven = Driven(np.asarray(np.poly(w).real, float), hand_kicks(network)[:, 0], handle.real)
    seen = [*own, *held, *averaged]
    numerator = _polynomials(free, change, push, reads[:1], seen)[1]
    first, last = np.flatnonzero(numerator)[[0, -1]].tolist()
    polynomials = _polynomials(free, change, push, reads, [*seen, *[last_step] * (last_step in read), *memories])
    polynomials = polynomials[:, : np.flatnonzero(polynomials.any(axis=0))[-1] + 1]  # the rest is not observable
    of_reading = numerator[first : last + 1], last - len(own)
    numbers = damping, stiffness, lag, damper, p, q
    places = (x, v), held, averaged, last_step, memories
    return LoneHand(*numbers, change, push, reads, *places, *of_reading, polynomials, driven)


def _polynomials(free: Floats, change: Floats, push: Floats, reads: Floats, state: list[int]) -> Floats:
    """Polynomials (1 + R, N + 1) in z of part of the ``state``, first that of which ``free`` is the factor: det(z - M)
    with M = 1 + change, in which every memory is a factor of its own; and that times the readings of (z - M)⁻¹ push."""
    change, push, reads = change[np.ix_(state, state)], push[state], reads[:, state]
    whole, moved = np.convolve(free, np.poly(1.0 + np.diag(change)[free.size - 1 :])), push
    columns = [push]
    for coefficient in whole[1:-1]:
        moved = moved + change @ moved + coefficient * push
        columns.append(moved)
    found = reads @ np.array(columns).T
    found[np.abs(found) <= NOTHING * np.abs(found).max(axis=1, keepdims=True)] = 0.0
    return np.vstack([whole, np.column_stack([np.zeros(len(reads)), found])])


def characteristic(hand: LoneHand, kappa: Floats, beta: Floats) -> list[Floats]:
    """Monic characteristic polynomial in z, highest power first, one array for each coefficient."""
    beta = beta - hand.lag * kappa
    return [constant + of_kappa * kappa + of_beta * beta for constant, of_kappa, of_beta in hand.polynomials.T.tolist()]


def relation_on_pair(hand: LoneHand, pair: PolePair, change: tuple[Floats, Floats]) -> Relation:
    """Returns (H, r) on a pair of poles, for the equation kappa + beta H + r = 0. ``change``: (p, q) of the mass alone
    minus those of the pair; without a drive w² + p w + q is the line of these two on the pair."""
    w, z, free = pair.w, pair.w.plus(1.0), LinearOnPair(change[1], change[0], pair)
    if hand.driven is not None:
        free = w.polynomial(hand.driven.free)
    numerator = z.polynomial(hand.numerator)
    if hand.lead < 0:
        ratio = w.power(0).over(z.power(-hand.lead).times(numerator))
    else:
        ratio = z.power(hand.lead).over(numerator)
    # Each memory of a damper for a reading of 1: it does not depend on the cause of the motion.
    values = _sensed(hand, pair, free) if hand.damper.senses else {}
    values[hand.last_step] = w.over(z)
    for at in hand.memories:
        values[at] = _sum(hand.change[at], values).over(w.plus(-float(hand.change[at, at])))
    return _sum(hand.reads[1], values), free.times(ratio)


def _sum(row: Floats, values: dict[int, LinearOnPair]) -> LinearOnPair:
    return total([value.scaled(float(row[at])) for at, value in values.items() if row[at]])


def _sensed(hand: LoneHand, pair: PolePair, free: LinearOnPair) -> dict[int, LinearOnPair]:
    """Velocities for a reading of 1. They are computed first for a force that moves the mass by 1, times z for each
    sample of its memory, so that no divisor is nearly zero."""
    w, z, (x, v), rows = pair.w, pair.w.plus(1.0), hand.moving, np.column_stack([hand.change, hand.push])
    reads = np.column_stack([hand.reads, np.zeros(2)])
    needed = np.vstack([rows[[x, v, *hand.averaged]], reads])
    acting = np.any(needed != 0.0, axis=0).tolist()  # few of a long delay's forces
    ages = zip([len(rows), *hand.held], range(len(hand.held), -1, -1), strict=True)
    forces = {at: z.power(age) for at, age in ages if acting[at]}
    of_x, of_v = _sum(rows[x], forces), _sum(rows[v], forces)
    values = {at: value.times(free) for at, value in forces.items()}
    values[x] = total([w.plus(-float(rows[v, v])).times(of_x), of_v.scaled(float(rows[x, v]))])
    values[v] = total([of_x.scaled(float(rows[v, x])), w.plus(-float(rows[x, x])).times(of_v)])
    if hand.averaged:
        averaged = {at: _sum(rows[at], values) for at in hand.averaged}
        values = {at: value.times(z) for at, value in values.items()} | averaged
    y = _sum(reads[0], values)
    return {at: value.over(y) for at, value in values.items() if reads[1, at]}


def element_of_relation(hand: LoneHand, relation: Relation) -> tuple[Floats, Floats]:
    """Returns (kappa, beta) that place the pair; not finite where they cannot distinguish its two poles."""
    (H, H_slope, _), (r, r_slope, _) = relation
    beta = -r_slope / H_slope
    kappa = -(r + beta * H)
    return kappa, beta + hand.lag * kappa
