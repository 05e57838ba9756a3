"""Stability of a scene in hands other than the declared one: any passive hand, or one of some mass and stiffness."""

from __future__ import annotations

import cmath
import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from hapsim.errors import UsageError
from hapsim.one_thread import one_thread
from hapsim.theory import Network
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.network import SURELY, poles_of, state_size
from hapsim.theory.network.impedance import device_matrix
from hapsim.theory.network.modes import snap_to_rest
from hapsim.theory.network.scene_passivity import HeldScene, Passivity, highest, no_derivation, passivity_of, peaks_of

Range = tuple[float, float]

_STANDS = 1e3  # of m/T: a hand with such friction stops within a thousandth of a sample
_CANDIDATES = 3  # frequencies at which a hand is sought
_BELOW_NYQUIST = 0.9 * math.pi  # at half the rate itself a motion is its own image
_LEVEL = 0.999  # of the maximum: above, the peak extends to rest
_CLOSER = np.array(
    [0.7, 0.8, 0.9, 0.95, 0.98, 1.0, 1.02, 1.05, 1.1, 1.2, 1.4]
)  # times the mass or the spring in resonance
_NEWTON, _FOUND = 30, 1e-10
_MOST_STATES = 150  # of a loop that is solved some hundred times
_GRID = np.array([0.0, 1e-4, 1e-3, 0.01, 0.03, 0.1, 0.3, 0.6, 1.0])  # of a range of masses, or of stiffnesses
_REFINED, _ABOUT = 3, (0.9, 0.97, 1.0, 1.03, 1.1)  # of the worst of them, and of their masses and stiffnesses


class ShakingHand(NamedTuple):
    """Hand that is shaken: a mass, or a spring to a fixed place, in addition to the device's own."""

    name: str
    """Device point that the hand holds; the others are free."""
    mass: float
    """Mass, kg."""
    stiffness: float
    """Stiffness, N/m."""
    frequency_hz: float
    growth: float
    """Factor of its motion in a sample, above 1."""


class WorstHand(NamedTuple):
    """Hand with which the loop is closest to its limit, or furthest beyond."""

    masses: tuple[float, ...]
    """Masses on each device point, kg, in addition to the device's own."""
    stiffnesses: tuple[float, ...]
    """Stiffnesses on each device point, N/m."""
    spectral_radius: float

    @property
    def is_stable(self) -> bool:
        """True if none of the hands that were searched is shaken."""
        return self.spectral_radius <= SURELY


@dataclass(frozen=True, eq=False)
class AnyHand:
    """Stability of one part of a scene, joined to no other, in any hands on it.

    Attributes:
        names: of the n device points.
        channels: of the device points.
    """

    DOCUMENT = (
        "friction needed_friction=needed needed_friction_of_single_hands=needed_for_one "
        "passive=is_passive grows frequency_hz lasting pushes_away not_derived shaking_hand=shaking"
    )

    names: tuple[str, ...]
    channels: tuple[int, ...]
    _network: Network
    _points: tuple[str, ...]
    grows: str = ""
    """State of its contacts in which a motion grows whatever hand holds it, such as "t is fast"; "": none. The rest
    applies to the assumed state."""

    @cached_property
    def not_derived(self) -> str:
        """Reason why the passivity condition is unknown; "" if it is known."""
        is_open = self._is_damped and bool((self.friction < self.needed).any()) and not self.grows
        is_open = is_open and self._found is None
        unproved = "the friction does not prove it, and what the damping of the transmission adds is not derived"
        return no_derivation(self._network) or unproved * is_open

    @cached_property
    def _is_damped(self) -> bool:
        """True if a transmission takes energy: less friction may then do than is needed at the motor."""
        return any(one.is_elastic and one.damping > 0.0 for one in self._network.drives)

    @cached_property
    def _held(self) -> HeldScene:
        return HeldScene(self._network)

    @property
    def friction(self) -> Floats:
        """Declared frictions (n,), N·s/m."""
        return self._network.channel_friction

    @cached_property
    def _passivity(self) -> Passivity:
        if no_derivation(self._network):
            return Passivity(math.nan, math.nan)
        with one_thread():
            return passivity_of(self._held)

    @cached_property
    def needed(self) -> Floats:
        """Frictions (n,), N·s/m, above which every passive hand, in any motion, is stable; infinite if none suffices,
        NaN if not computed."""
        own, found = self.friction, self._passivity.friction
        needed = found * own / own.mean() if (own > 0.0).all() and math.isfinite(found) else np.full(own.size, found)
        steps = 1 if self._network.board is None else self._network.board.steps
        return possible_friction(needed, self._network.channel_mass, self._network.rate * steps)

    @property
    def frequency_hz(self) -> float:
        """Frequency at which that friction is needed."""
        return self._passivity.frequency_hz

    @property
    def lasting(self) -> str:
        """Module that moves most in a motion that does not decay with the hands held; "" if every motion decays."""
        moved = self._passivity.lasting
        return self._points[int(np.argmax(moved))].partition(".")[0] if moved.size else ""

    @property
    def pushes_away(self) -> bool:
        """True if the scene drives the hands on at rest, so that no friction suffices."""
        return self._passivity.pushes_away

    @property
    def is_passive(self) -> bool | None:
        """True if the declared friction suffices in every state, None if unknown."""
        if self.grows:
            return False
        return None if self.not_derived or np.isnan(self.needed).any() else bool((self.friction >= self.needed).all())

    @cached_property
    def needed_for_one(self) -> float:
        """Friction below which a single mass or spring is shaken, N·s/m. `needed` is larger because it covers hands
        that also move at the images of a motion. NaN for several hands, behind a transmission with damping, and if not
        computed."""
        if (
            len(self.names) > 1
            or any(one.is_elastic for one in self._network.drives)
            or self.is_passive is None
            or not np.isfinite(self.needed).all()
        ):
            return math.nan
        with one_thread():
            theta = self._held.angles[self._held.angles < _BELOW_NYQUIST]
            _, most = highest(lambda angle: self._taken(angle, 0), theta)
        return max(0.0, float(self.friction[0]) + most)

    @cached_property
    def shaking(self) -> ShakingHand | None:
        """Single mass or spring on one device point that is shaken most; None if none was found."""
        return None if self.is_passive is not False else self._found

    @cached_property
    def _found(self) -> ShakingHand | None:
        with one_thread():
            found = [one for at in range(len(self.names)) for one in self._shaken(at)]
        return max(found, key=lambda one: one.growth, default=None)

    @np.errstate(all="ignore")
    def _shaken(self, at: int) -> Iterator[ShakingHand]:
        """Yields the hands on one device point that are in resonance where its impedance takes most from a hand."""
        for theta in self._taking(at):
            omega = theta * self._network.rate
            reactance = -float(self._held.handle_impedance(np.array([theta]), at)[0].imag)
            mass, stiffness = max(reactance, 0.0) / omega, max(-reactance, 0.0) * omega
            hands = ((share, self._pole(at, share * mass, share * stiffness, theta)) for share in _CLOSER.tolist())
            share, pole = max(hands, key=lambda one: np.nan_to_num(abs(one[1])))
            if abs(pole) > SURELY:
                hertz = abs(cmath.phase(pole)) * self._network.rate / (2.0 * math.pi)
                yield ShakingHand(self.names[at], share * mass, share * stiffness, hertz, abs(pole))

    def _taking(self, at: int) -> list[float]:
        """Angles theta of its least, negative resistance; of a peak that extends to rest, the half-value point."""
        theta = self._held.angles
        taken = self._taken(theta, at)
        found = []
        for peak in peaks_of(taken)[:_CANDIDATES].tolist():
            about = theta[max(peak - 1, 0) : peak + 2]
            place, most = highest(lambda angle: self._taken(angle, at), about)
            if taken[0] > _LEVEL * most > 0.0:
                place = float(theta[np.argmax(taken < 0.5 * taken[0])])
            found += [min(place, _BELOW_NYQUIST)] if most > 0.0 else []
        return found

    def _taken(self, theta: Floats, at: int) -> Floats:
        return np.asarray(-self._held.driving_impedance(theta, at).real)

    def _pole(self, at: int, mass: float, stiffness: float, theta: float) -> complex:
        """Returns a pole of the loop with this hand near theta, by secants; NaN if none is found."""
        hands = np.zeros((2, len(self.names)))
        hands[:, at] = mass, stiffness
        device = device_matrix(_with_hands(self._network, *hands))

        def met(w: Complexes) -> Complexes:
            return np.asarray(np.linalg.det(self._held.forces(w) + device(w)))

        w = np.exp(1j * theta) * np.array([1.0, 1.0 + 1e-6]) - 1.0
        before, here = (complex(one) for one in w)
        f_before, f = (complex(one) for one in met(w))
        first = abs(f)
        for _ in range(_NEWTON):
            if not abs(f) > _FOUND * first or f == f_before:
                break
            before, here, f_before = here, here - f * (here - before) / (f - f_before), f
            f = complex(met(np.array([here]))[0])
        return 1.0 + here if abs(f) <= _FOUND * first else complex(math.nan)

    def worst_hand(self, mass: Range, stiffness: Range) -> WorstHand | None:
        """Returns the worst of the hands that add a mass, kg, and a stiffness, N/m, in these ranges to each device
        point. They add no friction. The search uses a grid, the resonances where the impedance is most negative, and
        the neighbourhood of the worst of both. None if the loop is too large for it.

        Raises:
            UsageError: a range begins below 0, or ends before it begins.
        """
        for name, (low, high) in (("mass", mass), ("stiffness", stiffness)):
            if not 0.0 <= low <= high < math.inf:
                raise UsageError(f"a hand's {name}: found {low:g}:{high:g}, expected low:high, both 0 or more")
        if state_size(self._network) > _MOST_STATES or self._network.followers:  # of masses and delay; by FeltMass
            return None
        least, most = (np.repeat([mass[end], stiffness[end]], len(self.names)) for end in (0, 1))

        def judged(hands: Floats) -> tuple[float, Floats]:
            held = _with_hands(self._network, *hands.reshape(2, -1))
            return float(np.abs(snap_to_rest(held, poles_of(held))).max()), hands

        with one_thread():
            found = sorted(map(judged, self._hands(least, most)), key=lambda one: -one[0])[:_REFINED]
            shares = np.array([*itertools.product(_ABOUT, _ABOUT)])
            close = (
                np.clip(np.repeat(one, len(self.names)) * hands, least, most) for _, hands in found for one in shares
            )
            radius, hands = max([*found, *map(judged, close)], key=lambda one: one[0])
        masses, springs = hands.reshape(2, -1).tolist()
        return WorstHand(tuple(masses), tuple(springs), radius)

    def _hands(self, low: Floats, high: Floats) -> Iterator[Floats]:
        """Yields hands (2 n,): alike on all points, on each alone, and in resonance on each."""
        n = len(self.names)
        for shares in itertools.product(_GRID, _GRID):
            alike = low + (high - low) * np.repeat(shares, n)
            yield alike
            for at in range(n if n > 1 else 0):
                yield _alone(at, alike, low)
        for at in range(n if not no_derivation(self._network) else 0):
            for mass, stiffness in self._resonant(at, low[at], high[at], low[n + at], high[n + at]):
                yield _alone(at, np.repeat([mass, stiffness], n), low)

    def _resonant(
        self, at: int, lightest: float, heaviest: float, softest: float, stiffest: float
    ) -> Iterator[tuple[float, float]]:
        """Yields hands in these ranges in resonance on one point where its impedance is negative, the worst first."""
        hand = self.shaking
        if hand is not None and hand.name == self.names[at]:
            yield float(np.clip(hand.mass, lightest, heaviest)), float(np.clip(hand.stiffness, softest, stiffest))
        theta = self._held.angles
        impedance = self._held.handle_impedance(theta, at)
        omega, negative = theta * self._network.rate, impedance.real < 0.0
        stretches = np.split(np.arange(theta.size), np.flatnonzero(np.diff(negative)) + 1)
        for stretch in (one for one in stretches if negative[one[0]]):
            # At the least resistance, and all along the stretch.
            for index in {int(stretch[np.argmin(impedance.real[stretch])]), *stretch[:: max(1, stretch.size // 8)]}:
                w, missing = float(omega[index]), -float(impedance.imag[index])
                masses, springs = lightest + (heaviest - lightest) * _GRID, softest + (stiffest - softest) * _GRID
                for_springs, for_masses = missing / w + springs / w**2, w * (w * masses - missing)
                hands = np.vstack([np.append(masses, for_springs), np.append(for_masses, springs)])
                good = (hands >= [[lightest], [softest]]) & (hands <= [[heaviest], [stiffest]])
                yield from hands[:, good.all(axis=0)].T.tolist()


def possible_friction(needed: ArrayLike, mass: ArrayLike, rate: float) -> Floats:
    """Returns a needed friction, N·s/m; infinity if a device that has it stands still."""
    return np.where(np.asarray(needed) > _STANDS * rate * np.asarray(mass), math.inf, needed)


def _alone(at: int, hands: Floats, low: Floats) -> Floats:
    """Returns the hand at one device point, with the least on the others."""
    alone, places = low.copy(), [at, low.size // 2 + at]
    alone[places] = hands[places]
    return alone


def _with_hands(network: Network, masses: Floats, stiffnesses: Floats) -> Network:
    return replace(
        network, channel_mass=network.channel_mass + masses, channel_stiffness=network.channel_stiffness + stiffnesses
    )
