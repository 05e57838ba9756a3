"""Gain margins of a scene's links: of its network, of a lone hand, and of the regions of a hand's travel."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

from hapsim.prediction.felt import Felt
from hapsim.prediction.linear import LinearScene, links_of
from hapsim.prediction.stability import Region
from hapsim.theory import Margins, Stabilizing

Ranges = tuple[tuple[float, float], ...]
"""Of factors, (from, to)."""


@dataclass(frozen=True)
class LinkMargin:
    """The factors on one link from which the whole scene is unstable, all else as it is.

    Infinity where it never is. Where the scene is unstable as it stands: the largest factor below 1 that makes it
    stable, 0 where there is none. NaN where it was not worked out.
    """

    name: str
    stiffness_factor: float
    damping_factor: float
    stabilizing_stiffness: Ranges | None = None
    """Of an unstable scene: the factors that make it stable, the nearest range below 1 and the nearest above, as far as
    there are any. None where it is stable, or they were not worked out."""
    stabilizing_damping: Ranges | None = None


def link_margins(linear: LinearScene, margins: Margins, felt: tuple[Felt, ...]) -> tuple[LinkMargin, ...]:
    """Where a hand's only link is all that holds it, its margin by the closed formula; not where the scene is unstable,
    which another hand may be to blame for."""
    lone = {one.name: one for one in felt if len(links_of(linear, one.name)) == 1}
    named: list[LinkMargin] = []
    stabilizing = margins.stabilizing or [Stabilizing(None, None)] * len(margins.links)
    for (name, link), margin, ranges in zip(linear.links.items(), margins.links, stabilizing, strict=False):
        hand = None if margins.stabilizing else next((end for end in link.between if end in lone), None)
        factor = margin.stiffness_factor if hand is None else lone[hand].stiffness_factor
        named.append(LinkMargin(name, factor, margin.damping_factor, ranges.stiffness, ranges.damping))
    return tuple(named)


def least_margins(margins: tuple[LinkMargin, ...], regions: Iterable[Region]) -> tuple[LinkMargin, ...]:
    """Of each link the least margin in any region in which its hand is held."""
    least = {one.name: one for one in margins}
    for region in (one for one in regions if one.kind == "held" and one.is_stable):
        felt = region.felt
        stiffest, strongest = felt.stiffness * felt.stiffness_factor, felt.stable_damping[1]
        for name, link in region.linear.items():
            before = least.get(name)
            if before is None or before.stabilizing_stiffness is not None:
                continue
            # What all links may have together, without what the others have.
            stiffness = (stiffest - felt.stiffness) / link.stiffness + 1.0 if link.stiffness > 0.0 else math.inf
            damping = (strongest - felt.damping) / link.damping + 1.0 if link.damping > 0.0 else math.inf
            least[name] = replace(
                before,
                stiffness_factor=min(before.stiffness_factor, stiffness),
                damping_factor=min(before.damping_factor, damping),
            )
    return tuple(least.values())
