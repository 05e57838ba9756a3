"""Whether the poles of a network shake a hand: what surely grows, and what moves in it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hapsim.one_thread import one_thread
from hapsim.prediction.linear import instead_of
from hapsim.prediction.swings import Swing
from hapsim.theory import Network, NotWorkedOutError, Solution, solve
from hapsim.theory.network import LARGE, SURELY, state_size, transition

_MANY_STATES = 40  # eigenvalues of fewer take one thread anyway
_SQUARED = 24  # times at most: a motion that takes longer than 2^24 samples to die out is close to the limit
_GONE = 0.1  # of a power's norm: below 1 all moduli are
_MOST = 1e5  # of the norms before: the squares' rounding, 1e-16 of their own, is far below that


class Shaking(NamedTuple):
    """A motion that surely grows."""

    growth: float
    """By how much it is multiplied in a sample, above 1."""
    module: str
    """That moves most in it; "" where no motion was found that does."""
    state: str = ""
    """How the contacts of its part of the scene are: "finger is apart"; "" where they are as they are taken."""
    swing: Swing | None = None
    """How large it gets, where that was found."""

    @property
    def sentence(self) -> str:
        """Without a full stop."""
        by = "beyond all numbers" if self.growth > 1e300 else f"{self.growth:.3g}-fold"
        if self.growth < 2.0:
            by = f"by {100.0 * (self.growth - 1.0):.2g} %"
        whose = f"the motion of {self.module}" if self.module else "a motion"
        when = f" while {self.state}" if self.state else ""
        if self.swing is not None:
            when += f", to a swing of {self.swing.sentence}"
        remedy = "reduce the stiffness there, change its damping, add mass or raise the rate"
        return f"{whose} grows {by} a sample{when}; {remedy}"


def without_real(poles: Iterable[complex], count: int) -> list[complex]:
    """The poles without the largest real positive ones, this many: the snaps themselves, which drive a point on."""
    rest = list(poles)
    for _ in range(count):
        real = [pole for pole in rest if abs(pole.imag) <= 1e-6 * abs(pole) and pole.real > 0.0]
        if real:
            rest.remove(max(real, key=abs))
    return rest


@dataclass(eq=False)
class NetworkVerdict:
    """A network's poles, and what grows in it, worked out where they are asked for.

    Attributes:
        network: as the theory sees it. points: the names of its points.
    """

    network: Network
    points: tuple[str, ...]

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

    def shaken_by_network(self, snaps: int = 0) -> Shaking | None:
        """What surely grows; None also where the poles were not worked out for the scheme. `snaps`: how many real poles
        are a snap's own, which drives the points on before what grows more slowly is felt."""
        if not snaps and self.dies_out:
            return None
        solution = self.solved[1]
        if self.solved[2]:
            return None
        if math.isnan(solution.spectral_radius):
            return Shaking(math.inf, "")
        radius = solution.spectral_radius
        if snaps:
            every, rest = solution.poles.tolist(), without_real(solution.poles.tolist(), snaps)
            radius, driven = (max(map(abs, poles), default=0.0) for poles in (rest, {*every} - {*rest}))
        if not radius > (max(SURELY, driven) if snaps else SURELY):
            return None
        near = min(solution.modes, key=lambda mode: abs(abs(mode.pole) - radius), default=None)
        if near is None or abs(near.pole) < radius * (1.0 - 1e-9):
            return Shaking(radius, "")
        return Shaking(radius, self.points[int(np.argmax(near.participation))].partition(".")[0])
