"""What hands feel that move masses, or each other: the spring and damper of their own motions, where these are all that
they do; and what is always defined."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.prediction.predict_impedance import spring_and_damper
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
    state_size,
    static_stiffness,
)
from hapsim.theory.network.impedance import loop_impedance

HAND_HZ = (2.0, 8.0, 30.0)
"""At which a hand moves: slowly, as fast as it can, and shaken by what it holds."""
HAND_STIFFNESS = 300.0
"""N/m, of a hand that weighs something by shaking it."""
_OFF = 1.1  # of a mass that no longer feels like itself
_FREE = 1e-9  # of the stiffest link: what holds nothing
_HALVINGS = 20
_MOST_STATES = 100  # of the loop that is worked out fifty times


class Weight(NamedTuple):
    """How heavy masses feel that nothing holds, to a hand of `HAND_STIFFNESS`: kg."""

    mass: float
    """Of all that the hand moves."""
    felt: float
    continuous: float
    """What of it the same scene in continuous time has."""
    within_10_percent_hz: float
    """Up to where, shaken more slowly, it feels like itself within a tenth; NaN where it does nowhere."""
    to_simulate: float
    """So much has to be simulated to feel like `mass`; NaN where nothing does."""


class OwnMotion(NamedTuple):
    """Of one hand, beside a measurement: N/m, N·s/m, and what a spring and damper make of its mass."""

    k: float
    b: float
    frequency_hz: float
    damping_ratio: float


@dataclass(frozen=True, eq=False)
class FeltTogether:
    """What is felt on the device points of one part of a scene that no link joins to another.

    Attributes:
        names: of the n device points.
        channels: theirs.
        not_predicted: why no pair is worked out of what runs; "" where it is.
    """

    names: tuple[str, ...]
    channels: tuple[int, ...]
    not_predicted: str
    _network: Network
    _continuous: Network
    _eigen: tuple[Complexes, Complexes] | None
    """Of the network's loop, where they are known."""

    @cached_property
    def felt(self) -> FeltPair:
        """k and b (n, n) that are felt; beside the diagonal what one hand feels of another is negative."""
        if self.not_predicted:
            return no_pair(len(self.names), self.not_predicted)
        with one_thread():
            return felt_pair(self._network, self._eigen)

    @property
    def own_motion(self) -> OwnMotion | None:
        """Of a hand that shares its motion with no other; None where no pair is felt."""
        if self.felt.reason or len(self.names) > 1:
            return None
        k, b = float(self.felt.k[0, 0]), float(self.felt.b[0, 0])
        frequency, ratio = frequency_and_ratio(float(self._network.channel_mass[0]), k, b)
        return OwnMotion(k, b, float(frequency), float(ratio))

    @cached_property
    def weight(self) -> Weight | None:
        """Of a hand by itself whose masses nothing holds; else None."""
        network = self._network
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
        """How heavy its masses feel to one hand of this stiffness (N/m) that shakes them, and how heavy in continuous
        time, kg; NaN where that hand shakes them in no swing, None where it is not worked out."""
        network = self._network
        if len(self.names) > 1 or not network.point_mass.size or self.not_predicted:
            return None
        if state_size(network) > _MOST_STATES:
            return None
        with one_thread():
            return felt_mass(network, hand_stiffness)[0], continuous_mass(network, hand_stiffness)

    @cached_property
    def asked_for(self) -> FeltPair:
        """The same of the scene in continuous time: what sampling, hold and delay make another of."""
        with one_thread():
            # What is felt may be just within the bound, and this just beyond: they are shown side by side.
            return continuous_pair(self._continuous, 1.5 * CARRIED)

    @cached_property
    def static_stiffness(self) -> Floats:
        """(n, n): N/m, that steady pushes meet."""
        with one_thread():
            found = static_stiffness(self._network)
        return np.where(np.abs(found) > _FREE * np.abs(self._network.stiffness).max(initial=0.0), found, 0.0)

    @cached_property
    def at_frequencies(self) -> tuple[Floats, Floats]:
        """k and b, each (n, 3), that each hand meets moved at `HAND_HZ`, others held; NaN from half the rate on."""
        rendered = np.diagonal(loop_impedance(self._network, HAND_HZ).rendered, axis1=1, axis2=2).T
        k, b = spring_and_damper(np.array(HAND_HZ), rendered)
        return self._network.channel_stiffness[:, None] + k, self._network.channel_friction[:, None] + b


def _crossing(of: Callable[[float], tuple[float, float]], wanted: float, most: float) -> tuple[float, float]:
    """The number up to `most` from which on the first of what is made of it is above `wanted`, and the second; 0 where
    it is there, or is nowhere."""
    low, high = 1e-6 * most, most
    if of(low)[0] >= wanted or not of(high)[0] > wanted:  # what does not swing is not above
        return 0.0, math.nan
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        low, high = (low, middle) if of(middle)[0] > wanted else (middle, high)
    return low, of(low)[1]
