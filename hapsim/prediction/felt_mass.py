"""Admittance: the mass and damping (m, b) that a hand feels of a simulated (M, B), and how far both are stable.

The dual of the temporary hybrid system: the spring is real, in the hand, and the mass is simulated. With s the slowest
pair of poles, M and B feel like m = k/|s|² and b = -2 m Re s - bh of a real mass in the same hand; k is the hand's kh
and the stiffness of the scene's links, as they stand in the scene.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hapsim.number_format import number, rounded_down, rounded_up
from hapsim.one_thread import one_thread
from hapsim.theory import Network
from hapsim.theory.arrays import Complexes, Floats, sort_by_modulus
from hapsim.theory.network import loop, poles_of, state_size
from hapsim.theory.network.modes import AT_THE_LIMIT, NO_MOTION, snap_to_rest
from hapsim.theory.network.network import acting_links
from hapsim.units import Units

_MOST_STATES = 150  # of a loop that is solved some hundred times
_FACTORS = np.geomspace(1e-4, 1e4, 41)  # of a value, in search of stable ones
_LITTLE = 1e-2  # of M/T, and of M/T²
_OPEN = 1e-8  # relative, of a searched limit that is printed
_SAME = 1e-10  # relative: the end of a search

Range = tuple[float, float]
NONE: Range = (math.nan, math.nan)


@dataclass(frozen=True, eq=False)
class FeltMass:
    """Mass and damping that the hand at one device point feels. SI units; NaN where there is no such value."""

    DOCUMENT = (
        "name channel M=mass B=damping hand_stiffness hand_damping hand_mass m b reason spectral_radius "
        "stable_masses stable_damping stable_hand_stiffness largest_hand_mass"
    )

    name: str
    channel: int
    m: float
    b: float
    reason: str
    """Reason why no mass and damping is equivalent, to follow "because"; "" if one is."""
    _network: Network
    _number: int
    """Number of its channel in the network."""

    @property
    def mass(self) -> float:
        """Simulated mass M."""
        return float(self._network.channel_mass[self._number])

    @property
    def damping(self) -> float:
        """Simulated damping B."""
        return float(self._network.channel_friction[self._number]) - self.hand_damping

    @property
    def hand_stiffness(self) -> float:
        """Stiffness kh of the hand on it."""
        return float(self._network.channel_stiffness[self._number])

    @property
    def hand_damping(self) -> float:
        """Damping bh of that hand."""
        return self._network.followers[self._number].hand_damping

    @property
    def hand_mass(self) -> float:
        """Mass mh of that hand beyond the force sensor."""
        return self._network.followers[self._number].hand_mass

    @cached_property
    def spectral_radius(self) -> float:
        """Largest modulus of a pole, a free drift aside."""
        return _radius(self._network)

    @property
    def is_small(self) -> bool:
        """True if the ranges of stable values are searched."""
        return state_size(self._network) <= _MOST_STATES

    @cached_property
    def stable_masses(self) -> Range:
        """Least and largest simulated mass that is stable in this hand at this damping."""
        return self._stable("channel_mass", self.mass, 0.0)

    @cached_property
    def stable_damping(self) -> Range:
        """Least and largest simulated damping that is stable in this hand."""
        return self._stable("channel_friction", self.damping or _LITTLE * self._unit, self.hand_damping)

    @cached_property
    def stable_hand_stiffness(self) -> float:
        """Stiffest hand that is stable."""
        about = self.hand_stiffness or _LITTLE * self._unit * self._network.rate
        return _most(self._stable("channel_stiffness", about, 0.0))

    @cached_property
    def largest_hand_mass(self) -> float:
        """Largest mass of the hand beyond the force sensor that is stable: about M - B T/2."""

        def with_mass(value: float) -> Network:
            followers = list(self._network.followers)
            followers[self._number] = followers[self._number]._replace(hand_mass=value)
            return replace(self._network, followers=followers)

        return _most(_stable(with_mass, self.hand_mass or self.mass)) if self.is_small else math.nan

    @property
    def _unit(self) -> float:
        return self.mass * self._network.rate

    def _stable(self, key: str, about: float, besides: float) -> Range:
        """Returns the range of stable values of a channel's number, which has something ``besides``."""
        if not self.is_small:
            return NONE
        return _stable(lambda of: with_number(self._network, self._number, **{key: of + besides}), about)


def with_number(network: Network, number: int, **values: float) -> Network:
    """Returns a network with other numbers of a channel: ``channel_mass`` and so on."""
    changed: dict[str, Floats] = {name: getattr(network, name).copy() for name in values}
    for name, value in values.items():
        changed[name][number] = value
    return replace(network, **changed)  # type: ignore[arg-type]


def pair_of(poles: Complexes, rate: float) -> tuple[float, float]:
    """Returns |s|² and -2 Re s of the slowest pair, also of two real poles; NaN if there is none."""
    first, second = [*sort_by_modulus(poles[np.abs(poles) > NO_MOTION]), 0j, 0j][:2]
    is_pair = first.imag != 0.0 or (second.imag == 0.0 and second.real > 0.0 < first.real)
    if not is_pair:
        return NONE
    s = rate * np.log([first, second if first.imag == 0.0 else first.conjugate()])
    return float((s[0] * s[1]).real), float(-(s[0] + s[1]).real)


def felt_masses(network: Network, hands: Iterable[tuple[str, int]]) -> list[FeltMass]:
    """Returns what the hands on a part of the scene feel. ``hands``: names and channels, in the part's order."""
    square, decay = pair_of(poles_of(network), network.rate)
    k = _spring(network)
    whys = {
        (joined := joined_reason(network)): bool(joined),
        "nothing holds the hand: it drifts": not k > 0.0,
        "its slowest motions are no pair": not math.isfinite(square),
    }
    reason = next((why for why, is_so in whys.items() if is_so), "")
    m, found = math.nan if reason else k / square, []
    for i, (name, channel) in enumerate(hands):
        found.append(FeltMass(name, channel, m, m * decay - network.followers[i].hand_damping, reason, network, i))
    return found


def joined_reason(network: Network) -> str:
    """Returns why more than the simulated mass and its hand move in a part of the scene; "" if they alone do."""
    if network.channel_mass.size > 1:
        return "it is joined to another hand"
    return "it also moves masses of the scene" if network.point_mass.size > 0 else ""


def _spring(network: Network) -> float:
    """Returns the stiffness that holds the simulated mass, N/m: that of the hand and of the links."""
    return float(network.stiffness[acting_links(network)].sum() + network.channel_stiffness.sum())


def _radius(network: Network) -> float:
    """Returns the largest modulus of a pole, a free drift aside."""
    poles = snap_to_rest(network, poles_of(network))
    return float(np.abs(poles[poles != 1.0]).max())


def _stable(make: Callable[[float], Network], about: float) -> Range:
    """Returns the range of stable values that is nearest to this one; 0 or infinity where it goes on. NaN if none is
    stable. ``make``: the network of a value."""
    with one_thread():
        values = about * _FACTORS
        stable = np.array([_radius(make(float(one))) < 1.0 - AT_THE_LIMIT for one in values])
        if not stable.any():
            return NONE
        near = min(np.flatnonzero(stable), key=lambda at: abs(at - _FACTORS.size // 2))
        others = np.flatnonzero(~stable)
        below, above = others[others < near], others[others > near]
        low = _edge(make, values[below[-1]], values[below[-1] + 1]) if below.size else 0.0
        high = _edge(make, values[above[0]], values[above[0] - 1]) if above.size else math.inf
    return low, high


def _edge(make: Callable[[float], Network], outside: float, inside: float) -> float:
    from scipy.optimize import brentq

    if _radius(make(outside)) <= 1.0:  # at the limit, to rounding
        return outside
    return float(brentq(lambda of: _radius(make(of)) - 1.0, outside, inside, rtol=_SAME, xtol=_SAME * inside))


def _most(stable: Range) -> float:
    """Returns the end of a range that begins at 0; NaN of another."""
    return stable[1] if stable[0] == 0.0 else math.nan


def felt_sentence(felt: FeltMass, units: Units) -> str:
    """Returns what the hand feels of the simulated mass, without a full stop."""
    simulated = f"M = {units(felt.mass, 'kg')}, B = {units(felt.damping, 'N·s/m')}"
    if felt.reason:
        return f"no mass and damping is equivalent to {simulated}, because {felt.reason}"
    return f"{simulated} is felt as m = {units(felt.m, 'kg')}, b = {units(felt.b, 'N·s/m')}"


def admittance_sentences(felt: FeltMass, units: Units, name: str = "", in_hands: bool = True) -> Iterator[str]:
    """Yields why the hand at a device point feels no mass, and how far it is stable; `stable_words` has the rest.
    ``name``: that of the hand in them. ``in_hands``: with the hands in which it is stable."""
    name = name or felt.name
    if felt.reason:
        yield f"{name}: no mass and damping is equivalent, because {felt.reason}"
    if math.isnan(felt.stable_masses[0]) and felt.is_small:
        _, damping = stable_words(felt, units)
        instead = f"it is stable with a simulated damping of {damping}" if damping else "no damping is either"
        yield f"{name}: no simulated mass is stable in this hand at this damping; {instead}"
    if not in_hands:
        return
    ways = []
    if math.isfinite(felt.stable_hand_stiffness):
        times = felt.stable_hand_stiffness / felt.hand_stiffness if felt.hand_stiffness else math.inf
        factor = f" ({_down(times)} times this one)" if times < math.inf else ""
        ways.append(f"in hands of up to {units(felt.stable_hand_stiffness, 'N/m', _down)}{factor}")
    if math.isfinite(felt.largest_hand_mass):
        most = units(felt.largest_hand_mass, "kg", _down)
        ways.append(f"with up to {most} of hand and handle beyond the force sensor")
    if ways:
        yield f"{name}: stable {' and '.join(ways)}, each with all else as it is"


def stable_words(felt: FeltMass, units: Units) -> tuple[str, str]:
    """Returns the stable simulated masses and dampings; "" where there is none."""
    masses = _range_words(felt.stable_masses, lambda of, form: units.number(of, "kg", form), units.name("kg"))
    dampings = _range_words(felt.stable_damping, lambda of, form: units.number(of, "N·s/m", form), units.name("N·s/m"))
    return masses, dampings


def _range_words(stable: Range, number_of: Callable[[float, Callable[[float], str]], str], unit: str) -> str:
    least, most = stable
    if math.isnan(least):
        return ""
    if math.isinf(most):
        return f"{number_of(least, _up)} {unit} or more" if least else "any"
    low = f"{number_of(least, _up)} to " if least else "up to "
    return f"{low}{number_of(most, _down)} {unit}"


def _up(value: float) -> str:
    return _inward(value, rounded_up)


def _down(value: float) -> str:
    return _inward(value, rounded_down)


def _inward(value: float, rounding: Callable[[float], str]) -> str:
    """Returns a limit that was searched, rounded inward but for the digits that the search leaves open."""
    near = number(value, 4)
    return near if math.isclose(float(near), value, rel_tol=_OPEN) else rounding(value)


class MassPlane(NamedTuple):
    """Pairs that one hand feels over simulated masses (M,) and dampings (B,), and the largest modulus of a pole: arrays
    (B, M) in SI units, NaN where no mass and damping is equivalent."""

    masses: Floats
    dampings: Floats
    m: Floats
    b: Floats
    spectral_radius: Floats


def mass_plane(felt: FeltMass, masses: Floats, dampings: Floats) -> MassPlane:
    """Returns what this hand feels over simulated masses, kg, and dampings, N·s/m. A sample of the loop is linear in
    1/M and B/M, so three of its matrices have all others."""
    network, i = felt._network, felt._number
    follower, k = network.followers[i], _spring(network)

    def change(mass: float, damping: float) -> Floats:
        friction = damping + follower.hand_damping
        return np.asarray(loop(with_number(network, i, channel_mass=mass, channel_friction=friction)).change)

    M, B = float(masses[-1]), float(dampings[-1])
    light, heavy, damped = change(M, 0.0), change(2.0 * M, 0.0), change(M, B)
    of_mass, of_damping = 2.0 * M * (light - heavy), (damped - light) * M / B
    fixed, found = light - of_mass / M, np.full((3, dampings.size, masses.size), math.nan)
    for row, damping in enumerate(dampings.tolist()):
        each = fixed + (of_mass + damping * of_damping) / masses[:, None, None]
        poles = 1.0 + np.linalg.eigvals(each)
        for column, own in enumerate(poles):
            square, decay = pair_of(own, network.rate)
            m = k / square
            found[:, row, column] = m, m * decay - follower.hand_damping, np.abs(own).max()
    return MassPlane(masses, dampings, *found)
