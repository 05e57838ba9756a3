"""A part of a scene: the coordinates of hands that links join, and what the hands feel on them.

A hand whose links all end on grounds is a part of one, and has a closed form. What a part of several feels, or one that
moves masses, describes the hands' own motions, if these dominate; other quantities are always defined.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.prediction.any_hand import AnyHand
from hapsim.prediction.felt_alone import SHARES, Desired, Felt, Tolerance, Tolerances
from hapsim.prediction.felt_mass import FeltMass, felt_masses
from hapsim.prediction.over_phases import OverPhases, over_phases
from hapsim.theory import Network, frequency_and_ratio
from hapsim.theory.arrays import Floats, Indices
from hapsim.theory.network import (
    UNLIKE,
    FeltPair,
    continuous_mass,
    continuous_pair,
    drift_damping,
    felt_mass,
    felt_pair,
    is_large,
    no_pair,
    part_of,
    principal,
    state_size,
    steady_stiffness,
    without_observers,
)
from hapsim.theory.network.impedance import loop_impedance, spring_and_damper

if TYPE_CHECKING:
    from hapsim.prediction.stability import Region

HAND_HZ = (2.0, 8.0, 30.0)
"""Frequencies at which a hand moves: slowly, as fast as it can, and shaken by the masses that it holds."""
HAND_STIFFNESS = 300.0
"""Stiffness of a hand that shakes a mass to feel its weight, N/m."""
IN_ADMITTANCE = "in admittance a hand feels a mass and a damping"
_OFF = 1.1  # ratio of the felt to the true mass at the limit of its range
_FREE = 1e-12  # of the stiffest link: a smaller stiffness is rounding
_HALVINGS = 20
_MOST_STATES = 100  # of the loop that is solved fifty times


class Weight(NamedTuple):
    """Felt weight of free masses, to a hand of `HAND_STIFFNESS`, kg."""

    mass: float
    """Total mass that the hand moves."""
    felt: float
    continuous: float
    """Part of it that the same scene in continuous time has."""
    within_10_percent_hz: float
    """Frequency up to which it feels like itself within a tenth; NaN if it never does."""
    to_simulate: float
    """Mass to simulate so that it feels like `mass`; NaN if there is none."""


class OwnMotion(NamedTuple):
    """Own motion of one hand, to compare with a measurement: N/m, N·s/m, and its mass's frequency and damping ratio."""

    k: float
    b: float
    frequency_hz: float
    damping_ratio: float


class Along(NamedTuple):
    """Felt k and b of a hand along its coordinate, or along a principal direction of the plane, with the desired ones
    and the static stiffness."""

    hand: str
    of: str
    """The other hand of which it feels this: a spring and damper between them; "" for its own."""
    angle_deg: float
    """Angle from x towards y, 0 <= angle < 180; NaN on a line."""
    k: float
    b: float
    desired_k: float
    desired_b: float
    static_stiffness: float


@dataclass(frozen=True, eq=False)
class Part:
    """Coordinates of hands that links join, alone or over masses.

    Attributes:
        names: of the n device points; in the plane each hand has two, "hand.x" and "hand.y".
        channels: of the device points.
    """

    names: tuple[str, ...]
    channels: tuple[int, ...]
    _of: Any
    """Prediction of the scene, whose module imports this one."""
    _inside: Indices
    """Numbers of all its points."""

    @cached_property
    def hands(self) -> dict[str, list[int]]:
        """Numbers of each hand's coordinates in `names`."""
        found: dict[str, list[int]] = {}
        for number, name in enumerate(self.names):
            found.setdefault(name.partition(".")[0], []).append(number)
        return found

    @cached_property
    def alone(self) -> Felt | None:
        """Closed form of a part of one; None if its hand moves masses, or is joined to another."""
        return next((one for one in self._of.felt if (one.name,) == self.names), None)

    @cached_property
    def hand(self) -> Felt | None:
        """Closed form of one hand on grounds, also behind a transmission or a motor that lags: of such a hand its k and
        b, its stability and its configuration apply. None for another part."""
        return self.alone or (self._of.driven(self.names[0]) if len(self.names) == 1 else None)

    @property
    def whys(self) -> dict[str, str]:
        """Reason why each of its device points has no closed form, to follow its name; empty for a part of one."""
        return {name: self._of.coupled[name] for name in self.names if name in self._of.coupled}

    @property
    def wanted(self) -> Desired | None:
        """Desired spring and damper of a part of one, with a correction; else None."""
        return next((one for one in self._of.desired if one.name == self.names[0]), None)

    def tolerances(self, shares: Sequence[float] = SHARES) -> tuple[Tolerance, ...]:
        """Returns the tolerances of the device's parameters within which the corrected k and b of a hand on grounds are
        off by no more than each of these shares; empty if there is no correction, or it is not reached."""
        felt, (k, b), rendering = self.hand, self.asked, self._of.rendering
        if felt is None or rendering is None or rendering.kind.adapts or self.regions:
            return ()
        if self.alone is not None and self.wanted is None:
            return ()
        own = self._of.tolerances_found.setdefault(
            (felt.configuration, felt.stiffness, felt.damping), Tolerances(felt, k, b)
        )
        return tuple(one for one in map(own.within, shares) if one is not None)

    @cached_property
    def regions(self) -> tuple[Region, ...]:
        """Regions of a part of one, if it feels other springs and dampers at other places."""
        return self._of.regions.get(self.names[0], ())

    @property
    def region_here(self) -> Region | None:
        """The assumed one of these, with stuck friction; None if there are none."""
        here = self._of.here.get(self.names[0])
        every = (one for one in self.regions if (one.piece.low, one.piece.high) == (here.low, here.high))
        return next(every, None)

    @property
    def asked(self) -> tuple[float, float]:
        """Desired k and b of one hand on grounds, N/m and N·s/m, the device's own included; else NaN."""
        if self.hand is None:
            return math.nan, math.nan
        if self.wanted is not None:
            return self.wanted.k, self.wanted.b
        felt = self.alone or self._of.driven(self.names[0], as_written=True)
        own = felt.configuration
        return felt.stiffness + own.stiffness, felt.damping + own.friction

    @cached_property
    def network(self) -> Network:
        """The part as the theory sees it."""
        return part_of(self._of.judge.solved.network, self._inside)

    @cached_property
    def over_phases(self) -> OverPhases | None:
        """Least and largest k and b over all phases of several clocks; None of hands on one clock."""
        return over_phases(self.network, self._most) if self.network.clocks is not None else None

    @cached_property
    def any_hand(self) -> AnyHand:
        """Stability of the part in hands other than the declared ones."""
        points = tuple(self._of.points[at] for at in self._inside)
        return AnyHand(self.names, self.channels, self.network, points, self._grows(points))

    def _grows(self, points: tuple[str, ...]) -> str:
        """State of its contacts in which a motion grows fastest."""
        own = {"", *(name.partition(".")[0] for name in points)}
        found = [(one.growth, one.state) for one in self._of.states.growing if one.module in own]
        for region in (one for name in self.names for one in self._of.judge.regions.get(name, ())):
            words = (f"{link} is {state}" for link, state in region.piece.states.items() if state)
            found += (
                [(region.growth, ", ".join(words) or f"it is near {region.hand.units(region.piece.place, 'm')}")]
                if region.growth
                else []
            )
        return max(found, default=(0.0, ""))[1]

    @property
    def passive(self) -> bool | None:
        """True if no hand can make it unstable; None if unknown."""
        if self.alone is None or self.any_hand.grows:
            return self.any_hand.is_passive
        return self.alone.passive

    @property
    def needed_friction(self) -> Floats:
        """Friction (n,), N·s/m, from which on no hand can make it unstable; NaN if not derived."""
        return self.any_hand.needed if self.alone is None else np.array([self.alone.needed_friction])

    @property
    def is_admittance(self) -> bool:
        """True if its hands move simulated masses; they feel `felt_masses` then, and no k and b."""
        return bool(self.network.followers)

    @cached_property
    def felt_masses(self) -> tuple[FeltMass, ...]:
        """Mass and damping that each of its hands feels in admittance; else empty."""
        if not self.is_admittance:
            return ()
        with one_thread():
            return tuple(felt_masses(self.network, zip(self.names, self.channels, strict=True)))

    @cached_property
    def felt(self) -> FeltPair:
        """Felt k and b (n, n); off the diagonal, the part that one hand feels of another is negative."""
        if self.is_admittance:
            return no_pair(len(self.names), IN_ADMITTANCE)
        if (one := self.alone) is not None:
            return _of_one(one.k, one.b, one.reason)
        if (own := without_observers(self.network)) is None:
            return no_pair(len(self.names), "the predictor assumes another mass than the declared one")
        solution, is_whole = self._of.judge.solved.solution, self._inside.size == len(self._of.points)
        with one_thread():
            return felt_pair(own, solution.eigen if is_whole and own is self.network else None, self._most)

    @property
    def _most(self) -> float:
        """Limit of the difference between the answers of pair and hands; one hand without masses and drives has none,
        nor have its x and y."""
        inner = self.network.point_mass.size or self.network.drives
        return math.inf if len(self.hands) == 1 and not inner else UNLIKE

    @property
    def own_motion(self) -> Felt | OwnMotion | None:
        """Own motion of a single hand, in the plane along its stiffest principal direction; None if no pair is felt,
        but of a part of one always its closed form."""
        if self.alone is not None:
            return self.alone
        if self.felt.reason or len(self.hands) > 1:
            return None
        k, b, mass = float(self.felt.k[0, 0]), float(self.felt.b[0, 0]), float(self.network.channel_mass[0])
        if len(self.names) > 1:
            (angle, k, b), _ = principal(self.felt.k, self.felt.b)
            n = np.array([math.cos(angle), math.sin(angle)])
            mass = 1.0 / float(n @ np.linalg.solve(self.network.mass_matrix, n))
        frequency, ratio = frequency_and_ratio(mass, k, b)
        return OwnMotion(k, b, float(frequency), float(ratio))

    @cached_property
    def rows(self) -> tuple[Along, ...]:
        """Rows of what each hand feels along its coordinate, the others held, and then of each other hand; in the plane
        along its two principal directions, the stiffest first. Empty if no pair is felt; of a part of one its numbers
        are then NaN."""
        felt, found = self.felt, list[Along]()
        if felt.reason and self.alone is None:
            return ()
        every = felt.k, felt.b, self.desired.k, self.desired.b, self.static_stiffness
        for hand, (i, *others) in self.hands.items():
            if not others:
                found.append(Along(hand, "", math.nan, *(float(one[i, i]) for one in every)))
                between = [(of, j) for of, (j, *_) in self.hands.items() if j != i]
                found += [Along(hand, of, math.nan, *(-float(one[i, j]) for one in every)) for of, j in between]
                continue
            own = np.ix_([i, *others], [i, *others])
            for angle, k, b in principal(felt.k[own], felt.b[own]):
                n = np.array([math.cos(angle), math.sin(angle)])
                wanted = (float(n @ one[own] @ n) for one in every[2:])
                found.append(Along(hand, "", math.degrees(angle), k, b, *wanted))
        return tuple(found)

    def along(self, hand: str) -> list[Along]:
        """Returns those of this hand's own."""
        return [one for one in self.rows if one.hand == hand and not one.of]

    @cached_property
    def weight(self) -> Weight | None:
        """Felt weight of a single hand's free masses; else None."""
        if self.alone is not None or len(self.names) > 1:
            return None
        network = self.network
        mass, stiffest = float(network.point_mass.sum()), float(np.abs(network.stiffness).max(initial=0.0))
        acts = (network.stiffness != 0.0) | (network.damping != 0.0)
        is_held = bool((network.ends[acts] < 0).any()) or network.channel_stiffness[0] > 0.0
        weighs = None if is_held else self.weighs(HAND_STIFFNESS)
        if weighs is None or not np.isfinite(weighs).all():
            return None
        with one_thread():
            off, hz = _crossing(lambda kh: felt_mass(network, kh), _OFF * mass, stiffest)
            lighter, _ = _crossing(
                lambda share: felt_mass(replace(network, point_mass=share * network.point_mass), HAND_STIFFNESS),
                mass,
                1.0,
            )
        return Weight(mass, *weighs, hz if off else math.nan, lighter * mass or math.nan)

    def weighs(self, hand_stiffness: float) -> tuple[float, float] | None:
        """Returns the mass, kg, that its masses feel like to one hand of this stiffness (N/m) that shakes them, and the
        same in continuous time; NaN if the hand shakes them in no oscillation, None if not computed."""
        if self.alone is not None or len(self.names) > 1 or self.is_admittance:
            return None
        network = self.network
        if not network.point_mass.size or state_size(network) > _MOST_STATES:
            return None
        with one_thread():
            return felt_mass(network, hand_stiffness)[0], continuous_mass(network, hand_stiffness)

    @cached_property
    def desired(self) -> FeltPair:
        """Desired pair, of the scene in continuous time, without sampling, hold and delay."""
        if self.is_admittance:
            return no_pair(len(self.names), IN_ADMITTANCE)
        if self.alone is not None:
            return _of_one(*self.asked)
        written = self._of.written if self._of.rendering else self._of.network
        with one_thread():
            # The limit is wider: both pairs are shown side by side, and the felt one may be just within its own.
            return continuous_pair(part_of(written, self._inside), 1.5 * self._most)

    @cached_property
    def static_stiffness(self) -> Floats:
        """Static stiffness (n, n), N/m, that steady pushes meet; NaN in admittance."""
        if self.is_admittance:
            return np.full((len(self.names),) * 2, math.nan)
        if self.alone is not None:
            return np.array([[self.alone.steady_stiffness]])
        with one_thread():
            found = steady_stiffness(self.network)
        return np.where(np.abs(found) > _FREE * np.abs(self.network.stiffness).max(initial=0.0), found, 0.0)

    @cached_property
    def drift_damping(self) -> Floats:
        """Damping (n,), N·s/m, that brakes each hand that drifts on after a push; NaN if a spring brings it back."""
        if is_large(self.network):
            return np.full(len(self.names), math.nan)
        with one_thread():
            return drift_damping(self.network)

    @cached_property
    def at_frequencies(self) -> tuple[Floats, Floats]:
        """Stiffness and damping, each (n, 3), of each hand at `HAND_HZ`, the others held; NaN from half the rate on, in
        admittance, and of hands on several clocks."""
        if self.is_admittance or self.network.clocks is not None:
            return (unknown := np.full((len(self.names), len(HAND_HZ)), math.nan)), unknown
        rendered = np.diagonal(loop_impedance(self.network, HAND_HZ).rendered, axis1=1, axis2=2).T
        k, b = spring_and_damper(np.array(HAND_HZ), rendered)
        return self.network.channel_stiffness[:, None] + k, self.network.channel_friction[:, None] + b


def _of_one(k: float, b: float, reason: str = "") -> FeltPair:
    return FeltPair(np.array([[k]]), np.array([[b]]), 1.0, 0.0, (), reason)


def _crossing(of: Callable[[float], tuple[float, float]], wanted: float, most: float) -> tuple[float, float]:
    """Returns the number up to `most` at which the first value of the function exceeds `wanted`, and the second value
    there; 0 if it does everywhere, or nowhere."""
    low, high = 1e-6 * most, most
    if of(low)[0] >= wanted or not of(high)[0] > wanted:  # a motion without oscillation is not above
        return 0.0, math.nan
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if of(middle)[0] > wanted else (middle, high)
    return low, of(low)[1]
