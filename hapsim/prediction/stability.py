"""Verdict on stability, the same for `check`, arming, live changes, sweeps and the page.

A scene shakes the hand if a motion grows by more than rounding in a sample. Hands whose links all end on grounds are
judged by the formula of one hand, which resolves poles that rounding would place on the circle. It covers every region
of their travel (contacts, tables, detents, friction that sticks), and ignores the pole of a snap or of a free hand. If
such a region shakes a hand by less than a count and by almost no force, the scene may run. All other parts, which move
masses or other hands, are judged by the poles of the network, in every state that their contacts can be in
(`states.py`). A scene that is neither stable nor shaken is at the limit, or its scheme has no poles here, or it has
more states than were judged; it is not refused.
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
from hapsim.prediction.swings import NetworkVerdict, Rest, Shaking, Swing, Swinging, drop_real_poles, has_pieces
from hapsim.theory import Margins, Stabilizing
from hapsim.theory.network import SURELY, part_of, state_size

RegionKind = Literal["held", "free", "snap"]

_MOST_SWINGS = 4  # number of parts that are simulated
_POINTS = 1025  # at which the energy of a curved snap is summed


@dataclass(frozen=True, eq=False)
class Region:
    """Region of a hand's travel, and the spring and damper that the hand feels there in small motions."""

    DOCUMENT = (
        "low_m=piece.low high_m=piece.high place_m=piece.place K=piece.stiffness B=piece.damping k=held.k b=held.b "
        "kind stable=is_stable passive=felt.passive needed_friction=felt.needed_friction force_n=force "
        "snap_energy_j=snap_energy links=piece.states slide=piece.sliding reach_m=piece.reach curved=piece.is_curved "
        "branch=piece.branch"
    )

    piece: Piece
    """Position of the region, the scene's K and B, and the states of the links."""
    felt: Felt
    """Simulated K and B there, and the felt k and b."""
    linear: dict[str, LinearLink]
    """Simulated links of the hand there, by name."""
    hand: Characteristic
    """Force of the scene on the hand, over its travel."""
    crossed: bool = False
    """True of a snap that is narrower than a hand's way in a sample: nobody rests there. `felt` is with its fall spread
    over that way."""
    pieces: int = 1
    """Regions of a flank that this one stands for."""

    @cached_property
    def kind(self) -> RegionKind:
        """Kind of region: `held` by a spring, `free` without one, or a `snap` of negative stiffness."""
        stiffness = -1.0 if self.crossed else self.felt.stiffness + self.felt.configuration.stiffness
        return "held" if stiffness > 0.0 else "snap" if stiffness < 0.0 else "free"

    @property
    def held(self) -> Felt | None:
        """Felt spring and damper, if a spring holds the hand there; else None."""
        return self.felt if self.kind == "held" else None

    @cached_property
    def growth(self) -> float:
        """Factor by which the hand's motion grows in a sample; 0 if nothing shakes it."""
        if self.kind == "held" and self.felt.stable:
            return 0.0
        # The largest real pole does not count: it belongs to a snap or a free hand itself.
        grows = max(map(abs, drop_real_poles(self.felt.poles, int(self.kind != "held"))), default=0.0)
        return 0.0 if self.kind != "held" and grows < SURELY else grows

    @property
    def is_stable(self) -> bool:
        """True if nothing shakes the hand, apart from the motion of a snap itself."""
        return self.growth == 0.0

    @property
    def rest(self) -> Rest | None:
        """Rest of the hand under a steady push, with sticking friction: at the region's place, or, if the force there
        exceeds the limit, in the middle of the part in which it does not. None if the force exceeds the limit
        everywhere: then it is constant, and drives no motion."""
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
        """Force with which a hand at rest at its place pushes towards larger x, N."""
        return float(self.hand.force(self.piece.place))

    @cached_property
    def snap_energy(self) -> float:
        """Energy that a hand gains when it pushes through the snap, J, in the direction in which it gains more; 0 if
        the region is no snap. It is the work of the force at the start of the snap over its width, minus that of the
        scene, over the whole flank, however many regions it has."""
        piece = self.piece
        if self.kind != "snap" or not np.isfinite(piece.high - piece.low):
            return 0.0
        flank = self.hand.flank_at(0.5 * (piece.low + piece.high))
        if flank is not None and flank.energy:
            return flank.energy
        x = np.linspace(*piece.within, _POINTS if piece.is_curved else 2)
        return self.hand.flank(x, self.hand.force(x)).energy


@dataclass(eq=False)
class Judge(NetworkVerdict):
    """Verdict on a scene; its poles are computed on demand.

    Attributes:
        network, points: the whole scene as the theory sees it, and the names of its points.
        is_lone: whether it has nothing but hands, each an oscillator of its own.
        regions: of every hand with piecewise links.
        loose: the single hands that are not stable at their assumed positions, and those that no region holds.
        states: of all other piecewise links.
    """

    is_lone: bool
    regions: Mapping[str, tuple[Region, ...]]
    loose: tuple[Felt, ...]
    states: ContactStates
    _found: dict[str, Swing | None] = field(default_factory=dict, init=False)
    _of_parts: dict[int, Swing | None] = field(default_factory=dict, init=False)

    @cached_property
    def is_stable_as_taken(self) -> bool:
        """True if all computed motions decay in the assumed states of the contacts, in every region of the hands."""
        shaken = any(region.growth for regions in self.regions.values() for region in regions)
        if shaken or self.loose:
            return False
        # At a snap, the states of the contacts decide.
        return self.is_lone or self.settles or (self.snaps > 0 and not self._grown)

    @cached_property
    def is_stable(self) -> bool:
        """True if the scene is stable as assumed, and no motion grows in any state that its contacts can be in; False
        if a state was not judged, or if a knocked hand swings on from piece to piece of a board's lines."""
        return self.is_stable_in_states and not self.swings_on

    @cached_property
    def is_stable_in_states(self) -> bool:
        """True if the scene is stable in each state; the swings from state to state on a board's lines aside."""
        return self.is_stable_as_taken and not self.states.growing and not self.states.unjudged

    @property
    def swings_on(self) -> bool:
        """True if a hand swings on that follows a board's lines, though each state of its contacts is stable."""
        return self.network.board is not None and self.is_stable_in_states and bool(self.swings)

    @cached_property
    def shaking(self) -> Shaking | None:
        """Motion that will surely shake a hand; None if there is none, or if it is not certain."""
        if self._shaken_hand is not None:
            return self._shaken_hand
        for i, one in enumerate(self._grown):
            swing = self._swing_of_part(i)
            if swing is None or not swing.is_unnoticed:
                return one.shaking._replace(swing=swing)
        return None

    @cached_property
    def _grown(self) -> list[Grown]:
        """Growing motions in parts of the scene that are judged by the poles of the network, the fastest first."""
        taken = None if self.is_lone else self.shaken_by_network()
        found = self.states.grown(taken is not None, self.regions)
        if found or taken is None or taken.snaps or taken.module in self._unstable:
            return found
        return [Grown(taken, [], [])]

    def _swing_of_part(self, number: int) -> Swing | None:
        """Returns the oscillation of one of these parts."""
        if number not in self._of_parts:
            self._of_parts[number] = self.states.swing_of(self._grown[number])
        return self._of_parts[number]

    def is_soon_stable(self, most_states: int) -> bool:
        """Returns True if `shaking` is None and this is found without poles of a network, and without squares of a
        transition of more than `most_states` rows. False proves nothing."""
        is_quick = self.is_lone or state_size(self.network) <= most_states
        if not is_quick or self._unstable or self._shaken_hand is not None:
            return False
        return (self.is_lone or self.decays) and not self.states.growing

    @cached_property
    def _unstable(self) -> dict[str, list[Region]]:
        """Regions of each hand that surely shake it; hands without such regions are omitted."""
        shaken = {name: [one for one in every if one.growth > SURELY] for name, every in self.regions.items()}
        return {name: every for name, every in shaken.items() if every}

    @cached_property
    def swings(self) -> dict[str, Swing | None]:
        """Oscillations of the hands that their regions shake, and of the point that moves most in each of the first
        other parts with a growing motion; None where one was not found. On a board, those that go on after a knock."""
        if self.network.board is not None:
            return dict(self.states.lasting_swings(self.solved.solution.poles))
        found: dict[str, Swing | None] = {}
        for i, one in enumerate(self._grown[:_MOST_SWINGS]):
            swing = self._swing_of_part(i)
            found[one.shaking.module if swing is None else swing.point] = swing
        return found | {name: self.swing_of(name) for name in self._unstable}

    def swing_of(self, name: str) -> Swing | None:
        """Returns the oscillation of a hand that its regions shake. None also if its links are not simulated as in the
        scene, or include dry friction."""
        if name not in self._found:
            regions, self._found[name] = self._unstable[name], None
            hand, felt = regions[0].hand, [(one.felt, one.piece) for one in regions]
            as_written = all((a.stiffness, a.damping) == (b.stiffness, b.damping) for a, b in felt)
            if as_written:
                network = part_of(self.network, np.array([self.points.index(name)]))
                laws = {i: link.law for i, link in enumerate(hand.links.values()) if has_pieces(link.law)}
                swinging = Swinging(network, [name], laws, hand.force_limit, (hand.low, hand.high), hand.count)
                self._found[name] = swinging.swing_at([one.rest for one in regions if one.rest is not None])
        return self._found[name]

    @cached_property
    def _shaken_hand(self) -> Shaking | None:
        """First hand that is shaken in one of its regions; of single hands alone, the one that is shaken most."""
        for name, regions in self._unstable.items():
            worst = max(regions, key=lambda region: region.growth)
            swing = self.swing_of(name)
            if swing is None or not swing.is_unnoticed:
                where = max(worst.linear, key=lambda at: worst.linear[at].stiffness)
                return Shaking(worst.growth, f"{name} in {where}", swing=swing)
        loose = [felt for felt in self.loose if felt.name not in self._unstable]  # those were tested above
        off = [Shaking(felt.spectral_radius, felt.name) for felt in loose] if self.is_lone else []
        if off and math.isnan(self.solved.solution.spectral_radius):
            return Shaking(math.inf, "")
        return max((shaking for shaking in off if shaking.growth > SURELY), default=None)


Ranges = tuple[tuple[float, float], ...]
"""Ranges of factors, (from, to)."""


@dataclass(frozen=True)
class LinkMargin:
    """Factors on one link from which the whole scene is unstable, with everything else unchanged. Infinity if there is
    none. For an unstable scene: the largest factor below 1 that makes it stable, 0 if there is none. NaN if it was not
    computed."""

    DOCUMENT = (
        "stiffness_factor? damping_factor? stabilizing_stiffness_factors=stabilizing_stiffness "
        "stabilizing_damping_factors=stabilizing_damping"
    )

    name: str
    stiffness_factor: float
    damping_factor: float
    stabilizing_stiffness: Ranges | None = None
    """Factors that make an unstable scene stable: the nearest range below 1 and the nearest above, if any. None if the
    scene is stable, or if they were not computed."""
    stabilizing_damping: Ranges | None = None


def link_margins(
    linear: LinearScene, margins: Margins, felt: tuple[Felt, ...], regions: Iterable[Region]
) -> tuple[LinkMargin, ...]:
    """Margin of each link: that in the network, or the least in any region in which its hand is held. For the only link
    of a hand that nothing else holds it is computed by the closed formula, except in an unstable scene, where another
    hand may be the cause."""
    lone = {one.name: one for one in felt if len(links_of(linear, one.name)) == 1}
    least: dict[str, LinkMargin] = {}
    stabilizing = margins.stabilizing or [Stabilizing(None, None)] * len(margins.links)
    for (name, link), margin, ranges in zip(linear.links.items(), margins.links, stabilizing, strict=False):
        own = None if margins.stabilizing else next((lone[end] for end in link.between if end in lone), None)
        factor = margin.stiffness_factor if own is None else own.stiffness_factor
        least[name] = LinkMargin(name, factor, margin.damping_factor, ranges.stiffness, ranges.damping)
    for region in (one for one in regions if one.kind == "held" and one.is_stable):
        hand = region.felt
        for name, link in region.linear.items():
            before = least.get(name)
            if before is None or before.stabilizing_stiffness is not None:
                continue
            # Total of all links, minus the part of the others.
            stiffness = damping = math.inf
            if link.stiffness > 0.0:
                stiffness = (hand.stiffness * hand.stiffness_factor - hand.stiffness) / link.stiffness + 1.0
            if link.damping > 0.0:
                damping = (hand.stable_damping[1] - hand.damping) / link.damping + 1.0
            least[name] = replace(
                before,
                stiffness_factor=min(before.stiffness_factor, stiffness),
                damping_factor=min(before.damping_factor, damping),
            )
    return tuple(least.values())
