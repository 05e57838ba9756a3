"""Gain margins: what multiplies one link's stiffness, or damping, where the whole loop becomes unstable.

With one link's K made (1 + s) K there is a pole at z where s is a certain function of z, -1/(K e' D^-1 e), the change
that takes a pole there (``margin_response.py``). A pole comes to the unit circle where that is real; and as s grows it
goes outward where its imaginary part grows with the angle. So one walk along the circle tells every link's margins.
What it finds is then checked against the poles themselves, as far as time allows, the nearest margins first.
"""

from __future__ import annotations

import math
from contextlib import suppress
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hapsim.theory.arrays import Bools, Complexes, Floats
from hapsim.theory.network.margin_angles import AFFORDABLE, angles_about, angles_for_links
from hapsim.theory.network.margin_modal import ModalResponse, NotModalError
from hapsim.theory.network.margin_poles import LIMIT, Range, Varied, by_poles, largest_below
from hapsim.theory.network.margin_ranges import Stabilizing, by_poles_agree, stable_ranges
from hapsim.theory.network.margin_response import Response, TooLargeError
from hapsim.theory.network.network import Network, is_centred
from hapsim.theory.network.solve import solve
from hapsim.theory.network.sparse import one_thread
from hapsim.theory.network.state import is_large, state_size

AnyResponse = Response | ModalResponse
Ranges = list[list[tuple[Range, ...] | None]]

QUICK = 2000  # multiplications for each place on the circle: an elimination of fewer takes no time
ONCE = 200_000  # the cube of so many masses' number for each of them: as long does it take to find their modes, once
NEVER = 1e9  # a factor above it is none
FEW, MANY = 3, 300  # crossings that are worked out of one link, and of a hand's
LESS = 3  # so much less is done for the other links of a large scene
NOT_FINE = ", coarser than the scene's resonances: a true margin may be nearer to 1"
MOST_CRITICAL = 8  # links of a large scene that are worked out besides those that touch a hand
REFINED = 1e-11  # relative change of a factor that is settled
WELL = 1e-7  # the same where each place on the circle is a lot of work
FAR = 1.5  # a crossing so many times as far from 1 as a settled one is dropped
PASSES = 8  # that a refinement takes, about
EIGENVALUES = 1e8  # what the eigenvalues that check may cost: their number times the cube of the state's size
TRIED = 6  # of them for the check of a link's ranges
SCANNED = 60  # numbers in the state of the largest scene that is searched by its poles, where the walk was wrong


class Margin(NamedTuple):
    """By what a link's stiffness, and its damping, may be multiplied before the loop is unstable, all else as it is.

    Infinity where it never is. Where the loop is unstable as it stands: the largest factor below 1 under which it is
    stable, 0 where there is none. NaN where it was not worked out.
    """

    stiffness_factor: float
    damping_factor: float


class Crossings(NamedTuple):
    """Where a factor takes a pole across the circle: a row each.

    ``link``: number among the response's. ``of``: 0 for its stiffness, 1 for its damping. ``left``, ``right``: between
    which angles. ``factor``: about. ``poles``: how many go outward as the factor grows, negative: inward.
    """

    link: NDArray[np.intp]
    of: NDArray[np.intp]
    left: Floats
    right: Floats
    factor: Floats
    poles: NDArray[np.intp]

    def some(self, which: NDArray) -> Crossings:
        return Crossings(*(column[which] for column in self))


class Margins(NamedTuple):
    """Each link's, in their order; of a large scene some, the others NaN.

    Attributes:
        links: (L,). method: in words, which were worked out and how surely; "" for every one, between all poles.
        stabilizing: (L,), of a loop that is unstable as it stands; else none.
    """

    links: list[Margin]
    method: str = ""
    stabilizing: list[Stabilizing] = []  # noqa: RUF012


def margins_of(network: Network, poles: Complexes | None = None) -> Margins:
    """By how much each link may be stiffer, or damp more, before the scene becomes unstable.

    ``poles``: those of the scene, where they are known already.
    """
    unknown = [Margin(math.nan, math.nan)] * len(network.ends)
    poles = solve(network).poles if poles is None else poles
    if not np.isfinite(poles).all():
        return Margins(unknown, "none was worked out: the scene's numbers are out of range")
    growing = int((np.abs(poles) > LIMIT).sum())
    not_known = [Stabilizing(None, None)] * len(network.ends) if growing else []
    if not is_centred(network):
        found = by_poles(network, growing > 0)
        margins = [Margin(stiffness, damping) for stiffness, damping in found.factors.tolist()]
        return Margins(margins, found.method, [Stabilizing(*of_link) for of_link in found.ranges])
    try:
        with np.errstate(all="ignore"), one_thread(is_large(network)):
            response = _response(network)
            factors, ranges, how = _worked_out(network, response, poles, growing)
    except TooLargeError:
        return Margins(unknown, "none was worked out: the scene's links are too many, and too entwined", not_known)
    idle = Margin(0.0, 0.0) if growing else Margin(math.inf, math.inf)
    margins = [idle] * len(network.ends)
    for link, (stiffness, damping) in zip(response.links[: len(factors)].tolist(), factors.tolist(), strict=True):
        margins[link] = Margin(stiffness, damping)
    stabilizing = [Stabilizing((), ())] * len(network.ends) if growing else []
    for link, of_link in zip(response.links[: len(ranges)].tolist(), ranges, strict=True):
        stabilizing[link] = Stabilizing(*of_link)
    return Margins(margins, how, stabilizing)


def _response(network: Network) -> AnyResponse:
    """By the modes of the scene's structures, where it would take longer to eliminate its points again and again."""
    eliminated = None
    with suppress(TooLargeError):
        eliminated = Response(network)
    if eliminated and eliminated.work < max(QUICK, network.point_mass.size**3 / ONCE):
        return eliminated
    with suppress(NotModalError):
        by_modes = ModalResponse(network)
        if eliminated is None or by_modes.work < eliminated.work:
            return by_modes
    if eliminated is None:
        raise TooLargeError
    return eliminated


def _worked_out(network: Network, response: AnyResponse, poles: Complexes, growing: int) -> tuple[Floats, Ranges, str]:
    """(links, 2): the factors of stiffness and damping; of an unstable loop, the ranges of factors that make it stable;
    and which, in words."""
    margin_links = len(network.ends) if network.margin_links is None else network.margin_links
    every = np.arange(np.searchsorted(response.links, margin_links))
    if not every.size:
        return np.zeros((0, 2)), [], ""
    touching = _touching(network, response)[: every.size]
    large, how = is_large(network), ""
    angles = angles_about(poles, response.work * (LESS if large else 1))
    crossings = _crossings(response, angles, every)
    if touching.any():
        hands = np.flatnonzero(touching)
        angles, fine = angles_for_links(response, hands, angles)
        closer = _crossings(response, angles, hands)
        crossings = _joined([crossings.some(~touching[crossings.link]), closer])
        if large:
            how = f"the hands' links were followed through {angles.size} angles" + ("" if fine else NOT_FINE)
    factors = np.full((every.size, 2), 0.0 if growing else math.inf)
    affordable = int(AFFORDABLE / (PASSES * max(1, response.work)))
    chosen = _candidates(crossings, growing, touching, max(FEW, affordable // (2 * every.size)))
    precision = REFINED
    if large or chosen.link.size > affordable:
        precision = WELL
        known = touching.copy()
        critical = chosen.some(~touching[chosen.link])
        known[critical.link[np.argsort(np.abs(np.log(critical.factor)), kind="stable")][:MOST_CRITICAL]] = True
        chosen = chosen.some(known[chosen.link])
        factors[~known] = math.nan
        some = f"{known.sum()} of {every.size} links: those that touch a hand and the most critical of the others"
        how = f"{some}; {how}" if how else some
    chosen = chosen._replace(factor=_refined(response, chosen, precision, growing))
    factors[chosen.link, chosen.of] = math.nan  # where none of them turns out to be the margin, nothing is known
    margin = _decided(chosen, growing)
    best = np.fmax if growing else np.fmin
    best.at(factors, (margin.link, margin.of), margin.factor)
    if not large:
        _check(network, response, factors, growing > 0)
    return factors, _ranges(network, response, chosen, factors, growing) if growing else [], how


def _touching(network: Network, response: AnyResponse) -> Bools:
    """Which links touch a hand."""
    ends = network.ends[response.links]
    hand = (ends >= 0) & (ends < network.channel_mass.size)
    return hand[:, 0] | hand[:, 1]


def _crossings(response: AnyResponse, angles: Floats, links: NDArray[np.intp]) -> Crossings:
    """Those of some links that show between neighbouring angles, the first 0, the last pi; and those at 0 and pi."""
    found = []
    step = response.at_once(links.size)
    for start in range(0, angles.size - 1, step):
        part = angles[start : start + step + 1]
        answer = response.at(part, None if links.size == response.links.size else links)
        for of, change in enumerate(answer):
            found.append(_between(change, part, of))
            if start == 0:
                found.append(_at_an_end(change[:, 0], change[:, 1].imag, 0.0, of))
            if start + step >= angles.size - 1:
                found.append(_at_an_end(change[:, -1], -change[:, -2].imag, math.pi, of))
    every = _joined(found)
    return every._replace(link=links[every.link])


def _joined(parts: list[Crossings]) -> Crossings:
    return Crossings(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def _between(change: Complexes, angles: Floats, of: int) -> Crossings:
    before, after = change[:, :-1], change[:, 1:]
    link, i = np.nonzero((before.imag < 0.0) != (after.imag < 0.0))
    a, b = before[link, i], after[link, i]
    # Along the change, which is straight about a pole, and along its inverse, which is straight about a zero.
    straight = 1.0 + a.real + (b.real - a.real) * a.imag / (a.imag - b.imag)
    c, d = 1.0 / a, 1.0 / b
    inverse = 1.0 + 1.0 / (c.real + (d.real - c.real) * c.imag / (c.imag - d.imag))
    factor = np.where((inverse > 1.0) & ((inverse < straight) | (straight < 1.0)), inverse, straight)
    poles = np.where(b.imag > a.imag, 2, -2)
    inner = (angles[i] > 0.0) & (angles[i + 1] < math.pi)  # at the ends themselves it is real
    return Crossings(link, np.full(link.size, of), angles[i], angles[i + 1], factor, poles).some(inner)


def _at_an_end(change: Complexes, growth: Floats, angle: float, of: int) -> Crossings:
    link = np.flatnonzero(np.isfinite(change) & np.isfinite(growth) & (growth != 0.0))
    place = np.full(link.size, angle)
    poles = np.where(growth[link] > 0.0, 1, -1)
    return Crossings(link, np.full(link.size, of), place, place, 1.0 + change[link].real, poles)


def _candidates(crossings: Crossings, growing: int, hands: Bools, count: int) -> Crossings:
    """Of each link's quantity the ``count`` nearest to 1 of those that may be the margin, of the hands' links many."""
    above = _nearest(crossings.some((crossings.factor > 1.0) & (crossings.factor < NEVER)), hands, count)
    if not growing:
        return above
    below = _nearest(crossings.some((crossings.factor > 0.0) & (crossings.factor < 1.0)), hands, count)
    return _joined([below, above])


def _nearest(some: Crossings, hands: Bools, count: int) -> Crossings:
    near = np.abs(np.log(some.factor))
    return some.some(_first(some, near, count) | (hands[some.link] & _first(some, near, MANY)))


def _decided(crossings: Crossings, growing: int) -> Crossings:
    """Those at which the loop becomes unstable: all above 1, or, of one that is, those below which nothing grows."""
    if not growing:
        return crossings.some((crossings.factor > 1.0) & (crossings.factor < NEVER))
    below = crossings.some((crossings.factor > 0.0) & (crossings.factor < 1.0))
    below = below.some(np.lexsort((-below.factor, below.of, below.link)))
    # Going down from 1, what is left outside after each crossing; the count begins anew with each link's quantity.
    base = _begins(below.link * 2 + below.of)
    total = np.cumsum(below.poles)
    outside = growing - (total - (total[base] - below.poles[base]))
    return below.some(outside <= 0)


def _first(crossings: Crossings, by: Floats, count: int) -> Bools:
    """Which are among the first ``count`` of their link's quantity."""
    group = crossings.link * 2 + crossings.of
    order = np.lexsort((by, group))
    first = np.zeros(group.size, dtype=bool)
    first[order] = np.arange(group.size) - _begins(group[order]) < count
    return first


def _begins(group: NDArray[np.intp]) -> NDArray[np.intp]:
    """Where each one's run of equal values begins."""
    new = np.append(True, group[1:] != group[:-1])[: group.size]
    return np.maximum.accumulate(np.where(new, np.arange(group.size), 0))


def _refined(response: AnyResponse, crossings: Crossings, precision: float, growing: int) -> Floats:
    """The factors where the change is real, between each crossing's angles: false position, halved where it lingers."""
    left, right, factor = crossings.left.copy(), crossings.right.copy(), crossings.factor.copy()
    if not left.size:
        return factor
    at_left = _own(response, crossings, left).imag
    at_right = _own(response, crossings, right).imag
    settled = left == right
    active = np.flatnonzero(~settled)
    for step in range(60 if precision < WELL else 24):
        if not active.size:
            break
        a, b, fa, fb = left[active], right[active], at_left[active], at_right[active]
        middle = np.where(step % 3 == 2, 0.5 * (a + b), a + (b - a) * fa / (fa - fb))
        change = _own(response, crossings.some(active), middle)
        same = (change.imag < 0.0) == (fa < 0.0)
        left[active], right[active] = np.where(same, middle, a), np.where(same, b, middle)
        # Illinois: an end that stays counts half, so that it does not stay for ever.
        at_left[active] = np.where(same, change.imag, 0.5 * fa)
        at_right[active] = np.where(same, 0.5 * fb, change.imag)
        now = 1.0 + change.real
        done = (np.abs(now - factor[active]) < precision * np.abs(now)) | (change.imag == 0.0)
        done |= right[active] - left[active] <= 4e-16 * right[active]
        factor[active] = now
        settled[active] = done & (step >= 3)
        needed = growing > 0 or _may_be_nearest(crossings, factor, settled)
        active = np.flatnonzero(~settled & needed)
    factor[~settled] = math.nan
    return factor


def _may_be_nearest(crossings: Crossings, factor: Floats, settled: Bools) -> Bools:
    """Which are not far beyond a settled one of the same link's quantity, of a loop that is stable as it stands."""
    group = crossings.link * 2 + crossings.of
    nearest = np.full(int(group.max()) + 1, math.inf)
    above = settled & (factor > 1.0)
    np.minimum.at(nearest, group[above], factor[above] - 1.0)
    near: Bools = factor - 1.0 <= FAR * nearest[group]
    return near


def _own(response: AnyResponse, crossings: Crossings, angles: Floats) -> Complexes:
    """Each crossing's change at its own angle."""
    links, place = np.unique(crossings.link, return_inverse=True)
    out = np.zeros(angles.size, dtype=complex)
    step = response.at_once(links.size)
    for start in range(0, angles.size, step):
        part = slice(start, start + step)
        answer = response.at(angles[part], links)
        column = np.arange(angles[part].size)
        change = np.where(crossings.of[part, None] == 0, answer.stiffness[place[part]], answer.damping[place[part]])
        out[part] = change[column, column]
    return out


def _check(network: Network, response: AnyResponse, factors: Floats, unstable: bool) -> None:
    """Looks at the poles beside each factor, the nearest to 1 first; where they say otherwise, searches by them."""
    size = state_size(network)
    affordable = int(EIGENVALUES / (size + 40) ** 3)
    written = np.stack([network.stiffness[response.links], network.damping[response.links]], axis=1)
    with np.errstate(all="ignore"):
        order = np.argsort(np.abs(np.log(factors)).ravel(), kind="stable")
    for place in order[: max(0, affordable // 2)]:
        n, of = divmod(int(place), 2)
        if written[n, of] == 0.0:
            continue
        poles = Varied(network, int(response.links[n]), of)
        if not poles.agree(float(factors[n, of]), unstable) and size <= SCANNED:
            factors[n, of] = poles.searched(unstable)


def _ranges(network: Network, response: AnyResponse, chosen: Crossings, factors: Floats, growing: int) -> Ranges:
    """By the crossings that were worked out; of a small scene checked by its poles, and where they say otherwise,
    searched by them. A factor that the poles have corrected stays the larger end of the range below 1."""
    size = state_size(network)
    affordable = 0 if is_large(network) else int(EIGENVALUES / (size + 40) ** 3)
    ranges: Ranges = []
    for n in range(len(factors)):
        ranges.append([None, None])
        for of in (0, 1):
            own = chosen.some((chosen.link == n) & (chosen.of == of))
            known = not np.isnan(factors[n, of])
            found = stable_ranges(own.factor, own.poles, growing) if known or own.link.size else None
            if affordable > 0 and (network.stiffness, network.damping)[of][response.links[n]] != 0.0:
                affordable -= TRIED
                varied = Varied(network, int(response.links[n]), of)
                if not by_poles_agree(varied, found):
                    found = varied.stable_ranges() if size <= SCANNED else None
            ranges[n][of] = found
            if found is not None:
                factors[n, of] = largest_below(found)
    return ranges
