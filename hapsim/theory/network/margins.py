"""Gain margins: what multiplies one link's stiffness, or damping, where the whole loop becomes unstable.

Three ways lead to them. For a scene of CORDIS's scheme that is small enough, one eigenvalue problem a link and quantity
gives every factor at which a pole crosses the unit circle (``crossings.py``). For a large one the circle is sampled
(``large_margins.py``). For the other schemes the factors are searched by the poles (``changed_link.py``).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from hapsim.theory.arrays import Complexes, Floats, Indices
from hapsim.theory.network.changed_link import LIMIT, ChangedLink, Range
from hapsim.theory.network.crossings import Crossings
from hapsim.theory.network.large_margins import margins_along_circle
from hapsim.theory.network.large_modes import solve
from hapsim.theory.network.network import Network, acting_links, is_centred, touches_channel
from hapsim.theory.network.sparse import one_thread
from hapsim.theory.network.state import state_size

MOST_STATES = 300  # numbers in the state of a scene whose crossings are all worked out
MANY_STATES = 40  # eigenvalues of fewer take one thread anyway
WORK = 1.5e9  # what margins may cost: eigenvalue problems times the cube of the state's size
EIGENVALUES = 6  # problems for the two margins of a link: the crossings, and two looks at the poles
SEARCHES = 140  # the same, of a search by the poles; four times as many for the ranges of an unstable loop
ONE_AT_LEAST = 200  # numbers in the state of the largest scene of another scheme of which one link is always searched
FOLLOWED = 16  # links of a large scene


class Margin(NamedTuple):
    """By what a link's stiffness, and its damping, may be multiplied before the loop is unstable, all else as it is.

    Infinity where it never is. Where the loop is unstable as it stands: the largest factor below 1 under which it is
    stable, 0 where there is none. NaN where it was not worked out.
    """

    stiffness_factor: float
    damping_factor: float


class Stabilizing(NamedTuple):
    """By what a link's stiffness, and its damping, may be multiplied so that an unstable loop becomes stable, all else
    as it is.

    The nearest range of factors (from, to) below 1, and the nearest above, as far as there are any: from 0, or to
    infinity, where it has no other end. None where they were not worked out.
    """

    stiffness: tuple[Range, ...] | None
    damping: tuple[Range, ...] | None


class Margins(NamedTuple):
    """Each link's, in their order; of a scene with many links or masses some, the others NaN.

    Attributes:
        links: (L,). method: in words, which were worked out and how surely; "" for every one.
        stabilizing: (L,), of a loop that is unstable as it stands; else none.
    """

    links: list[Margin]
    method: str = ""
    stabilizing: list[Stabilizing] = []  # noqa: RUF012


def margins_of(network: Network, poles: Complexes | None = None) -> Margins:
    """By how much each link may be stiffer, or damp more, before the scene becomes unstable.

    ``poles``: those of the scene, where they are known already.
    """
    poles = solve(network).poles if poles is None else poles
    if not np.isfinite(poles).all():
        unknown = [Margin(math.nan, math.nan)] * len(network.ends)
        return Margins(unknown, "none was worked out: the scene's numbers are out of range")
    unstable = bool((np.abs(poles) > LIMIT).any())
    links = acting_links(network)
    links = links[links < (len(network.ends) if network.margin_links is None else network.margin_links)]
    touching = touches_channel(network, links)
    links = links[np.argsort(~touching, kind="stable")]
    size = state_size(network)
    if not is_centred(network):
        return _by_poles(network, links, unstable)
    if size <= MOST_STATES:
        affordable = int(WORK / EIGENVALUES / (size + 40) ** 3)
        return _by_crossings(network, links, max(affordable, int(touching.sum())), unstable)
    return _along_circle(network, links if links.size <= FOLLOWED else links[: touching.sum()], poles, unstable)


def _by_crossings(network: Network, links: Indices, affordable: int, unstable: bool) -> Margins:
    crossings = Crossings(network) if links.size else None

    def ranges(changed: ChangedLink) -> tuple[Range, ...]:
        assert crossings is not None
        return changed.ranges_between(crossings.factors(changed.link, changed.quantity), unstable)

    how = f"{affordable} of {links.size} links, those that touch a hand first" if links.size > affordable else ""
    with one_thread(state_size(network) > MANY_STATES, with_scipy=False):
        return _margins(network, links, links[:affordable], ranges, unstable)._replace(method=how)


def _by_poles(network: Network, links: Indices, unstable: bool) -> Margins:
    searches = SEARCHES * (4 if unstable else 1)
    affordable = int(WORK / searches / (state_size(network) + 40) ** 3)
    affordable = max(affordable, int(state_size(network) <= ONE_AT_LEAST))
    how = "by the poles, in steps of a tenth, beyond tenfold of double: what comes and goes within one is not seen"
    if links.size and not affordable:
        how = f"none was worked out: of so many masses that is not done under scheme: {network.scheme}"
    elif links.size > affordable:
        how = f"{affordable} of {links.size} links, those that touch a hand first; {how}"
    found = _margins(network, links, links[:affordable], lambda changed: changed.ranges_searched(unstable), unstable)
    return found._replace(method=how if links.size else "")


def _margins(
    network: Network,
    links: Indices,
    known: Indices,
    ranges: Callable[[ChangedLink], tuple[Range, ...]],
    unstable: bool,
) -> Margins:
    """``links``: those of which margins are asked; ``known``: those among them that ``ranges`` works out."""
    factors = np.full((len(network.ends), 2), 0.0 if unstable else math.inf)
    factors[np.setdiff1d(links, known)] = math.nan
    found: list[list[tuple[Range, ...] | None]] = [[(), ()] for _ in network.ends]
    for link in np.setdiff1d(links, known).tolist():
        found[link] = [None, None]
    for link in known.tolist():
        for quantity, value in enumerate((network.stiffness[link], network.damping[link])):
            if value != 0.0:
                found[link][quantity] = one = ranges(ChangedLink(network, link, quantity))
                below = max((most for _, most in one if most <= 1.0), default=0.0)
                factors[link, quantity] = below if unstable else one[0][1]
    margins = [Margin(*pair) for pair in factors.tolist()]
    return Margins(margins, "", [Stabilizing(*of_link) for of_link in found] if unstable else [])


def _along_circle(network: Network, links: Indices, poles: Complexes, unstable: bool) -> Margins:
    factors: Floats = np.full((len(network.ends), 2), 0.0 if unstable else math.inf)
    asked = acting_links(network)
    asked = asked[asked < (len(network.ends) if network.margin_links is None else network.margin_links)]
    factors[asked] = math.nan
    margins = [Margin(*pair) for pair in factors.tolist()]
    if unstable or not links.size:
        why = "a large scene that is unstable" if unstable else "a large scene with so many links and no hand"
        not_known = [Stabilizing(None, None) if np.isnan(m[0]) else Stabilizing((), ()) for m in margins]
        how = f"none was worked out: that is not done of {why}" if asked.size else ""
        return Margins(margins, how, not_known if unstable else [])
    factors[links], how = margins_along_circle(network, links, poles)
    some = f"{links.size} of {asked.size} links, those that touch a hand; " if links.size < asked.size else ""
    return Margins([Margin(*pair) for pair in factors.tolist()], some + how)
