"""The one judge of stability: for `check`, arming, live changes, sweeps and the page.

A scene shakes the hand where a motion grows by more than rounding in a sample. Hands whose links all end on grounds are
judged by the formula of one hand, which resolves poles that rounding would place on the circle: in every region of
their travel (contacts, tables, detents, friction that sticks), without the pole that a snap or a free hand has by
itself. Where such a region shakes a hand by less than a count and by next to no force, the scene may run. Whatever
moves masses or other hands is judged by the poles of the network, in every state that its contacts can be in
(`states.py`). What is neither stable nor shakes is at the limit, or was not worked out for the scheme by which the
scene runs, or has more states than were judged: no reason to refuse it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from hapsim.prediction.characteristic import Characteristic, Piece
from hapsim.prediction.felt_alone import Felt
from hapsim.prediction.linear import LinearLink, LinearScene, links_of
from hapsim.prediction.reach import pressed_within
from hapsim.prediction.states import ContactStates, Grown
from hapsim.prediction.swings import NetworkVerdict, Rest, Shaking, Swing, Swinging, has_pieces, without_real
from hapsim.theory import Margins, Stabilizing
from hapsim.theory.network import SURELY, part_of, state_size

RegionKind = Literal["held", "free", "snap"]

_MOST_SWINGS = 4  # of parts, that are simulated
_POINTS = 1025  # at which the energy of a curved snap is summed


@dataclass(frozen=True, eq=False)
class Region:
    """A region of a hand's travel, and what the hand feels there when it moves by little."""

    DOCUMENT = (
        "low_m=piece.low high_m=piece.high place_m=piece.place K=piece.stiffness B=piece.damping k=held.k b=held.b "
        "kind stable=is_stable passive=felt.passive needed_friction=felt.needed_friction force_n=force "
        "snap_energy_j=snap_energy links=piece.states slide=piece.sliding reach_m=piece.reach curved=piece.is_curved"
    )

    piece: Piece
    """Its place, the scene's K and B, and how the links are."""
    felt: Felt
    """What is simulated there, and what it feels like."""
    linear: dict[str, LinearLink]
    """The simulated links of the hand there, by name."""
    hand: Characteristic
    """The force of the scene on the hand, over its travel."""

    @cached_property
    def kind(self) -> RegionKind:
        """`held` by a spring, `free` without one, or a `snap`: a negative stiffness drives the hand on."""
        stiffness = self.felt.stiffness + self.felt.configuration.stiffness
        return "held" if stiffness > 0.0 else "snap" if stiffness < 0.0 else "free"

    @property
    def held(self) -> Felt | None:
        """What the hand feels there, where a spring holds it."""
        return self.felt if self.kind == "held" else None

    @cached_property
    def growth(self) -> float:
        """By how much the hand is shaken in a sample; 0 where nothing shakes it."""
        if self.kind == "held" and self.felt.stable:
            return 0.0
        # Without the pole that a snap or a free hand has by itself: the largest real one.
        grows = max(map(abs, without_real(self.felt.poles, int(self.kind != "held"))), default=0.0)
        return 0.0 if self.kind != "held" and grows < SURELY else grows

    @property
    def is_stable(self) -> bool:
        """Whether nothing shakes the hand. In a snap: nothing but the snap itself; where it is free: nothing at all."""
        return self.growth == 0.0

    @property
    def rest(self) -> Rest | None:
        """Where a steady push holds the hand: at its place, or where the scene asks for more than the force limit in
        the middle of the part of the region in which it does not; friction sticks. None where it asks for more
        everywhere: the force is constant there, and drives nothing."""
        piece, hand, at = self.piece, self.hand, self.piece.place
        if abs(press := hand.press(at)) > hand.force_limit:
            low, high = piece.within
            if piece.is_curved or not math.isfinite(low + high):
                low, high = at, at
            low, high = pressed_within(low, high, press + piece.stiffness * at, -piece.stiffness, hand.force_limit)
            if not low <= high:
                return None
            at = 0.5 * (low + high)
        distances = [float(link.distance(at)) for link in hand.links.values() if has_pieces(link.law)]
        return Rest(at, distances, hand.press(at), piece.high - piece.low, self.growth)

    @property
    def force(self) -> float:
        """N, with which a hand at rest at its place pushes towards larger x."""
        return float(self.hand.force(self.piece.place))

    @cached_property
    def snap_energy(self) -> float:
        """J, that a hand gets which pushes through with the force at which the snap begins: the work of that force over
        its width, less that of the scene; 0 where it is none."""
        if self.kind != "snap" or not np.isfinite(self.piece.high - self.piece.low):
            return 0.0
        x = np.linspace(*self.piece.within, _POINTS if self.piece.is_curved else 2)
        force = self.hand.force(x)
        return float(np.trapezoid(np.max(force) - force, x))


@dataclass(eq=False)
class Judge(NetworkVerdict):
    """The verdict on a scene; its poles are worked out where they are asked for.

    Attributes:
        network, points: the whole scene as the theory sees it, and the names of its points.
        is_lone: whether it has nothing but hands, each an oscillator of its own.
        regions: of every hand with links that are not the same everywhere.
        loose: the lone hands that are not stable where they are taken to be, nor, where that is said, held anywhere.
        states: of all other links that are not the same everywhere.
    """

    is_lone: bool
    regions: Mapping[str, tuple[Region, ...]]
    loose: tuple[Felt, ...]
    states: ContactStates
    _found: dict[str, Swing | None] = field(default_factory=dict, init=False)
    _of_parts: dict[int, Swing | None] = field(default_factory=dict, init=False)

    @cached_property
    def is_stable_as_taken(self) -> bool:
        """Whether every motion dies out with the contacts as they are taken, wherever hands with regions are, as far as
        the poles were worked out."""
        shaken = any(region.growth for regions in self.regions.values() for region in regions)
        return not shaken and not self.loose and (self.is_lone or self.solved.solution.is_stable)

    @cached_property
    def is_stable(self) -> bool:
        """Whether it is stable as it is taken, and nothing grows in any state that its contacts can be in; not where
        one of these was not judged."""
        return self.is_stable_as_taken and not self.states.growing and not self.states.unjudged

    @cached_property
    def shaking(self) -> Shaking | None:
        """What will surely shake a hand; None where nothing does, or it is not sure."""
        if self._shaken_hand is not None:
            return self._shaken_hand
        for i, one in enumerate(self._grown):
            swing = self._swing_of_part(i)
            if swing is None or not swing.is_unnoticed:
                return one.shaking._replace(swing=swing)
        return None

    @cached_property
    def _grown(self) -> list[Grown]:
        """What grows in each part of the scene that is judged by the poles of the network, the fastest first."""
        taken = None if self.is_lone else self.shaken_by_network()
        found = self.states.grown(taken is not None, self.regions)
        if found or taken is None or taken.module in self._unstable:
            return found
        return [Grown(taken, [], [])]

    def _swing_of_part(self, number: int) -> Swing | None:
        """Of one of these."""
        if number not in self._of_parts:
            self._of_parts[number] = self.states.swing_of(self._grown[number])
        return self._of_parts[number]

    def is_soon_stable(self, most_states: int) -> bool:
        """Whether `shaking` is None, where that is found without poles of a network, nor squares of a transition with
        more than `most_states` rows. False says nothing."""
        is_quick = self.is_lone or state_size(self.network) <= most_states
        if not is_quick or self._unstable or self._shaken_hand is not None:
            return False
        return (self.is_lone or self.dies_out) and not self.states.growing

    @cached_property
    def _unstable(self) -> dict[str, list[Region]]:
        """The regions of each hand that surely shake it, where there are any."""
        shaken = {name: [one for one in every if one.growth > SURELY] for name, every in self.regions.items()}
        return {name: every for name, every in shaken.items() if every}

    @cached_property
    def swings(self) -> dict[str, Swing | None]:
        """Of each hand that its regions shake, and of what moves most in other parts in which something grows (of some
        of them at most), how far it swings; None where that was not found."""
        found: dict[str, Swing | None] = {}
        for i, one in enumerate(self._grown[:_MOST_SWINGS]):
            swing = self._swing_of_part(i)
            found[one.shaking.module if swing is None else swing.point] = swing
        return found | {name: self.swing_of(name) for name in self._unstable}

    def swing_of(self, name: str) -> Swing | None:
        """Of a hand that its regions shake; None also where links are not simulated as they are written, for the state
        that is read, or one is dry friction."""
        if name not in self._found:
            regions, self._found[name] = self._unstable[name], None
            hand, felt = regions[0].hand, [(one.felt, one.piece) for one in regions]
            is_dry = any(math.isfinite(link.law.reach) for link in hand.links.values())
            is_read = all(one.predictor is None for one, _ in felt)
            as_written = all((a.stiffness, a.damping) == (b.stiffness, b.damping) for a, b in felt)
            if is_read and as_written and not is_dry:
                network = part_of(self.network, np.array([self.points.index(name)]))
                laws = {i: link.law for i, link in enumerate(hand.links.values()) if has_pieces(link.law)}
                swinging = Swinging(network, [name], laws, hand.force_limit, (hand.low, hand.high), hand.count)
                self._found[name] = swinging.swing_at([one.rest for one in regions if one.rest is not None])
        return self._found[name]

    @cached_property
    def _shaken_hand(self) -> Shaking | None:
        """The first hand that is shaken in one of its regions; of a scene of lone hands alone, the one shaken most."""
        for name, regions in self._unstable.items():
            worst = max(regions, key=lambda region: region.growth)
            swing = self.swing_of(name)
            if swing is None or not swing.is_unnoticed:
                where = max(worst.linear, key=lambda at: worst.linear[at].stiffness)
                return Shaking(worst.growth, f"{name} in {where}", swing=swing)
        loose = [felt for felt in self.loose if felt.name not in self._unstable]  # those were looked at
        off = [Shaking(felt.spectral_radius, felt.name) for felt in loose] if self.is_lone else []
        if off and math.isnan(self.solved.solution.spectral_radius):
            return Shaking(math.inf, "")
        return max((shaking for shaking in off if shaking.growth > SURELY), default=None)


Ranges = tuple[tuple[float, float], ...]
"""Of factors, (from, to)."""


@dataclass(frozen=True)
class LinkMargin:
    """The factors on one link from which the whole scene is unstable, all else as it is.

    Infinity where it never is. Where the scene is unstable as it stands: the largest factor below 1 that makes it
    stable, 0 where there is none. NaN where it was not worked out.
    """

    DOCUMENT = (
        "stiffness_factor? damping_factor? stabilizing_stiffness_factors=stabilizing_stiffness "
        "stabilizing_damping_factors=stabilizing_damping"
    )

    name: str
    stiffness_factor: float
    damping_factor: float
    stabilizing_stiffness: Ranges | None = None
    """Of an unstable scene: the factors that make it stable, the nearest range below 1 and the nearest above, as far as
    there are any. None where it is stable, or they were not worked out."""
    stabilizing_damping: Ranges | None = None


def link_margins(
    linear: LinearScene, margins: Margins, felt: tuple[Felt, ...], regions: Iterable[Region]
) -> tuple[LinkMargin, ...]:
    """Of each link the margin in the network, or the least in any of these regions in which its hand is held. Where a
    hand's only link is all that holds it, by the closed formula; not where the scene is unstable, which another hand
    may be to blame for."""
    lone = {one.name: one for one in felt if len(links_of(linear, one.name)) == 1}
    least: dict[str, LinkMargin] = {}
    stabilizing = margins.stabilizing or [Stabilizing(None, None)] * len(margins.links)
    for (name, link), margin, ranges in zip(linear.links.items(), margins.links, stabilizing, strict=False):
        own = None if margins.stabilizing else next((lone[end] for end in link.between if end in lone), None)
        factor = margin.stiffness_factor if own is None else own.stiffness_factor
        least[name] = LinkMargin(name, factor, margin.damping_factor, ranges.stiffness, ranges.damping)
    for region in (one for one in regions if one.kind == "held" and one.is_stable):
        hand = region.felt
        stiffest, strongest = hand.stiffness * hand.stiffness_factor, hand.stable_damping[1]
        for name, link in region.linear.items():
            before = least.get(name)
            if before is None or before.stabilizing_stiffness is not None:
                continue
            # What all links may have together, without what the others have.
            stiffness = (stiffest - hand.stiffness) / link.stiffness + 1.0 if link.stiffness > 0.0 else math.inf
            damping = (strongest - hand.damping) / link.damping + 1.0 if link.damping > 0.0 else math.inf
            least[name] = replace(
                before,
                stiffness_factor=min(before.stiffness_factor, stiffness),
                damping_factor=min(before.damping_factor, damping),
            )
    return tuple(least.values())
