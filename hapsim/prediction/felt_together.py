"""Springs and dampers that hands feel that move masses, or each other. They describe the hands' own motions, if these
dominate; other quantities are always defined."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.theory import Network, frequency_and_ratio
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network import (
    CARRIED,
    FeltPair,
    continuous_mass,
    continuous_pair,
    felt_mass,
    felt_pair,
    no_pair,
    principal,
    state_size,
    static_stiffness,
)
from hapsim.theory.network.impedance import loop_impedance, spring_and_damper

HAND_HZ = (2.0, 8.0, 30.0)
"""Frequencies at which a hand moves: slowly, as fast as it can, and shaken by the masses that it holds."""
HAND_STIFFNESS = 300.0
"""Stiffness of a hand that shakes a mass to feel its weight, N/m."""
_OFF = 1.1  # ratio of the felt to the true mass at the limit of its range
_FREE = 1e-9  # of the stiffest link: a smaller stiffness holds nothing
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


@dataclass(frozen=True, eq=False)
class FeltTogether:
    """Felt springs and dampers on the device points of one part of a scene that no link joins to another.

    Attributes:
        names: of the n device points.
        channels: of the device points.
        not_predicted: reason why no pair is computed for the run; "" if one is.
    """

    names: tuple[str, ...]
    channels: tuple[int, ...]
    not_predicted: str
    _network: Network
    _continuous: Network
    _eigen: tuple[Complexes, Complexes] | None
    """Eigenvalues and eigenvectors of the network's loop, if known."""

    @cached_property
    def felt(self) -> FeltPair:
        """Felt k and b (n, n); off the diagonal, the part that one hand feels of another is negative."""
        if self.not_predicted:
            return no_pair(len(self.names), self.not_predicted)
        with one_thread():
            return felt_pair(self._network, self._eigen, self._most)

    @property
    def _most(self) -> float:
        """Limit of the share of other motions; x and y of a single hand, without masses, have none."""
        return math.inf if self._is_one_hand and not self._network.point_mass.size else CARRIED

    @property
    def _is_one_hand(self) -> bool:
        return len({name.partition(".")[0] for name in self.names}) == 1

    @property
    def own_motion(self) -> OwnMotion | None:
        """Own motion of a single hand, in the plane along its stiffest principal direction; None if no pair is felt."""
        if self.felt.reason or not self._is_one_hand:
            return None
        k, b, mass = float(self.felt.k[0, 0]), float(self.felt.b[0, 0]), float(self._network.channel_mass[0])
        if len(self.names) > 1:
            (angle, k, b), _ = principal(self.felt.k, self.felt.b)
            n = np.array([math.cos(angle), math.sin(angle)])
            mass = 1.0 / float(n @ np.linalg.solve(self._network.mass_matrix, n))
        frequency, ratio = frequency_and_ratio(mass, k, b)
        return OwnMotion(k, b, float(frequency), float(ratio))

    @cached_property
    def weight(self) -> Weight | None:
        """Felt weight of a single hand's free masses; else None."""
        network = self._network
        if len(self.names) > 1:
            return None
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
        network = self._network
        if len(self.names) > 1 or not network.point_mass.size or self.not_predicted:
            return None
        if state_size(network) > _MOST_STATES:
            return None
        with one_thread():
            return felt_mass(network, hand_stiffness)[0], continuous_mass(network, hand_stiffness)

    @cached_property
    def asked_for(self) -> FeltPair:
        """Desired pair, of the scene in continuous time, without sampling, hold and delay."""
        with one_thread():
            # The limit is wider: both pairs are shown side by side, and the felt one may be just within its own.
            return continuous_pair(self._continuous, 1.5 * self._most)

    @cached_property
    def static_stiffness(self) -> Floats:
        """Static stiffness (n, n), N/m, that steady pushes meet."""
        with one_thread():
            found = static_stiffness(self._network)
        return np.where(np.abs(found) > _FREE * np.abs(self._network.stiffness).max(initial=0.0), found, 0.0)

    @cached_property
    def at_frequencies(self) -> tuple[Floats, Floats]:
        """Stiffness and damping, each (n, 3), of each hand at `HAND_HZ`, the others held; NaN from half the rate on."""
        rendered = np.diagonal(loop_impedance(self._network, HAND_HZ).rendered, axis1=1, axis2=2).T
        k, b = spring_and_damper(np.array(HAND_HZ), rendered)
        return self._network.channel_stiffness[:, None] + k, self._network.channel_friction[:, None] + b


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
