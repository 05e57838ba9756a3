"""The one judge of stability: for `check`, arming, live changes, sweeps and the page.

A scene shakes the hand where a motion grows by more than rounding in a sample. Hands whose links all end on grounds are
judged by the formula of one hand, which resolves poles that rounding would place on the circle: in every region of
their travel (contacts, tables, detents, friction that sticks), without the pole that a snap or a free hand has by
itself. Whatever moves masses or other hands is judged by the poles of the whole network. What is neither stable nor
shakes is at the limit, or was not worked out for the scheme by which the scene runs: no reason to refuse it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.prediction.characteristic import Characteristic, Piece
from hapsim.prediction.felt import Felt
from hapsim.prediction.linear import LinearLink, instead_of
from hapsim.theory import Network, NotWorkedOutError, Solution, solve
from hapsim.theory.network import LARGE, state_size, transition

RegionKind = Literal["held", "free", "snap"]

SURELY = 1.0 + 1e-9
"""What grows by more in a sample is not at the limit."""
MARGINAL = 1e-9
"""Of the spectral radius: a free motion, which rounding places on either side of 1."""
_MANY_STATES = 40  # eigenvalues of fewer take one thread anyway
_SQUARED = 24  # times at most: a motion that takes longer than 2^24 samples to die out is close to the limit
_GONE = 0.1  # of a power's norm: below 1 all moduli are
_MOST = 1e5  # of the norms before: the squares' rounding, 1e-16 of their own, is far below that
_POINTS = 1025  # at which the energy of a curved snap is summed


class Shaking(NamedTuple):
    """A motion that surely grows."""

    growth: float
    """By how much it is multiplied in a sample, above 1."""
    module: str
    """That moves most in it; "" where no motion was found that does."""

    @property
    def sentence(self) -> str:
        """Without a full stop."""
        by = "beyond all numbers" if self.growth > 1e300 else f"{self.growth:.3g}-fold"
        if self.growth < 2.0:
            by = f"by {100.0 * (self.growth - 1.0):.2g} %"
        whose = f"the motion of {self.module}" if self.module else "a motion"
        return (
            f"{whose} grows {by} a sample; reduce the stiffness there, change its damping, add mass or raise the rate"
        )


@dataclass(frozen=True, eq=False)
class Region:
    """A region of a hand's travel, and what the hand feels there when it moves by little."""

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

    @cached_property
    def growth(self) -> float:
        """By how much the hand is shaken in a sample; 0 where nothing shakes it."""
        if self.kind == "held" and self.felt.stable:
            return 0.0
        grows = modulus_without(self.felt.poles, self.kind)
        return 0.0 if self.kind != "held" and grows < SURELY else grows

    @property
    def is_stable(self) -> bool:
        """Whether nothing shakes the hand. In a snap: nothing but the snap itself; where it is free: nothing at all."""
        return self.growth == 0.0

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


def modulus_without(poles: Iterable[complex], kind: RegionKind) -> float:
    """The largest modulus of a pole, without the one that a snap or a free hand has by itself: the largest real one."""
    rest = list(poles)
    real = [pole for pole in rest if abs(pole.imag) <= 1e-6 * abs(pole) and pole.real > 0.0]
    if kind != "held" and real:
        rest.remove(max(real, key=abs))
    return max(map(abs, rest), default=0.0)


@dataclass(eq=False)
class Judge:
    """The verdict on a scene; its poles are worked out where they are asked for.

    Attributes:
        network, points: the whole scene as the theory sees it, and the names of its points.
        is_lone: whether it has nothing but hands, each an oscillator of its own.
        regions: of every hand with links that are not the same everywhere.
        loose: the lone hands that are not stable where they are taken to be, nor, where that is said, held anywhere.
    """

    network: Network
    points: tuple[str, ...]
    is_lone: bool
    regions: Mapping[str, tuple[Region, ...]]
    loose: tuple[Felt, ...]

    @cached_property
    def solved(self) -> tuple[Network, Solution, str]:
        """The network, its poles and modes; where they are not worked out, those of `instead_of` it, and a sentence."""
        with one_thread(_MANY_STATES < state_size(self.network) <= LARGE):
            try:
                return self.network, solve(self.network), ""
            except NotWorkedOutError as reason:
                instead, sentence = instead_of(self.network, reason)
                return instead, solve(instead), sentence

    @cached_property
    @np.errstate(all="ignore")
    def dies_out(self) -> bool:
        """Whether every motion of the network dies out, where squares of its transition show it, in a fifth of the time
        that eigenvalues take: False says nothing."""
        if state_size(self.network) > LARGE:
            return False
        try:
            power = transition(self.network)
        except NotWorkedOutError:
            return False
        for _ in range(_SQUARED):
            norm = np.abs(power).sum(axis=0).max(initial=0.0)
            if not _GONE <= norm < _MOST:
                return bool(norm < _GONE)
            power = power @ power
        return False

    @cached_property
    def is_stable(self) -> bool:
        """Whether every motion dies out, wherever the hands are, as far as the poles were worked out."""
        shaken = any(region.growth for regions in self.regions.values() for region in regions)
        return not shaken and not self.loose and (self.is_lone or self.solved[1].is_stable)

    @cached_property
    def shaking(self) -> Shaking | None:
        """What will surely shake a hand; None where nothing does, or it is not sure."""
        if self._shaken_hand or self.is_lone or self.dies_out:
            return self._shaken_hand
        return None if self.solved[2] else self._shaking_network()

    def is_soon_stable(self, most_states: int) -> bool:
        """Whether `shaking` is None, where that is found without poles of a network, nor squares of a transition with
        more than `most_states` rows. False says nothing."""
        is_quick = self.is_lone or state_size(self.network) <= most_states
        return is_quick and self._shaken_hand is None and (self.is_lone or self.dies_out)

    @cached_property
    def _shaken_hand(self) -> Shaking | None:
        """The first hand that is shaken in one of its regions; of a scene of lone hands alone, the one shaken most."""
        for name, regions in self.regions.items():
            worst = max(regions, key=lambda region: region.growth)
            if worst.growth > SURELY:
                return Shaking(
                    worst.growth, f"{name} in {max(worst.linear, key=lambda at: worst.linear[at].stiffness)}"
                )
        off = [Shaking(felt.spectral_radius, felt.name) for felt in self.loose] if self.is_lone else []
        if off and math.isnan(self.solved[1].spectral_radius):
            return Shaking(math.inf, "")
        return max((shaking for shaking in off if shaking.growth > SURELY), default=None)

    def _shaking_network(self) -> Shaking | None:
        solution = self.solved[1]
        if math.isnan(solution.spectral_radius):
            return Shaking(math.inf, "")
        if not solution.spectral_radius > SURELY:
            return None
        fastest = max(solution.modes, key=lambda mode: abs(mode.pole), default=None)
        if fastest is None or abs(fastest.pole) < solution.spectral_radius * (1.0 - 1e-9):
            return Shaking(solution.spectral_radius, "")
        return Shaking(solution.spectral_radius, self.points[int(np.argmax(fastest.participation))].partition(".")[0])
