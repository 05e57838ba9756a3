"""The closed loop of any linear scene as arrays: device channels, CORDIS masses and visco-elastic links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hapsim.theory import checks
from hapsim.theory.arrays import Complexes, Floats, sort_by_modulus
from hapsim.theory.interface import DAMPERS, HOLDS, SAMPLINGS
from hapsim.theory.interface.shape import Damper
from hapsim.theory.network.margin import Margin, margins_of
from hapsim.theory.network.modes import Mode, Solution, modes_of, snapped
from hapsim.theory.network.state import Triplets, transition

__all__ = ["LARGE", "Margin", "Mode", "Network", "Solution"]

_quietly = np.errstate(all="ignore")  # what is out of range becomes NaN

LARGE = 1000  # numbers in the state; above, eigenvalues of the whole matrix take longer than a user waits
AT_THE_LIMIT = 1e-12  # a modulus this close to 1 is 1, to rounding

BACKWARD = DAMPERS["backward"](0.0)


@dataclass(frozen=True, eq=False)
class Network:
    """Device channels, masses and links that run together at one rate.

    Points are numbered: 0 to C - 1 the device channels, C to C + M - 1 the simulated masses, -1 a ground. A
    simulated mass moves by the centred scheme, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n]. A link's force on its
    first end is -K (xa - xb)[n] - (B/T) (va - vb)[n], the opposite on its second; its damper makes v, in metres
    per sample period, of x (``shape.Damper``). A channel's x[n] is its measured sample; the sum of its links'
    forces acts on its real mass from (n + delay) T on, by the hold. The mass itself moves in continuous time,
    exactly: m x'' + b0 x' + k0 x = F (Florens et al., §6 and Figure 5).

    A damper that senses has at an end that is a channel the velocity that the device reads: with ideal sampling
    the real one at the instant of the sample, before any change of the force at that instant; with averaged
    sampling its mean over the period that has just ended.

    Attributes:
        rate: sample rate, Hz, > 0.
        channel_mass: (C,) real masses, kg, > 0.
        channel_friction: (C,) real viscous frictions b0, N·s/m, >= 0.
        delay: sample periods from the sampling of a position to the change of the force that answers it, >=
            0.
        hold: "zoh" or "impulse". sampling: "ideal" or "average". As for ``Configuration``.
        point_mass: (M,) simulated masses, kg, > 0.
        ends: (L, 2) the two points that each link joins.
        stiffness: (L,) K in N/m.
        damping: (L,) B in N·s/m.
        channel_stiffness: (C,) real springs k0 from the channels' masses to x = 0, N/m, >= 0; left out: none.
        damper: (L,) each link's, as ``interface.damper_named`` makes it; left out: all backward.
        judged: of how many links, the first, margins are worked out; left out: of all.

    Raises:
        ValueError: an argument is out of its range or its shape does not fit; the sentence says which.
    """

    rate: float
    channel_mass: Floats
    channel_friction: Floats
    delay: float
    hold: str
    sampling: str
    point_mass: Floats
    ends: NDArray[np.intp]
    stiffness: Floats
    damping: Floats
    channel_stiffness: Floats = ()  # type: ignore[assignment]
    damper: Sequence[Damper] = ()
    judged: int | None = None

    def __post_init__(self) -> None:
        mass = checks.vector("channel_mass", self.channel_mass, above=0.0)
        point_mass = checks.vector("point_mass", self.point_mass, above=0.0)
        ends = checks.link_ends("ends", self.ends, mass.size + point_mass.size)
        own = np.zeros(mass.size) if len(self.channel_stiffness) == 0 else self.channel_stiffness
        checked: dict[str, Any] = {
            "rate": checks.positive("rate", self.rate),
            "channel_mass": mass,
            "channel_friction": checks.vector("channel_friction", self.channel_friction, mass.size, least=0.0),
            "delay": checks.not_negative("delay", self.delay),
            "hold": checks.one_of("hold", self.hold, HOLDS),
            "sampling": checks.one_of("sampling", self.sampling, SAMPLINGS),
            "point_mass": point_mass,
            "ends": ends,
            "stiffness": checks.vector("stiffness", self.stiffness, len(ends)),
            "damping": checks.vector("damping", self.damping, len(ends)),
            "channel_stiffness": checks.vector("channel_stiffness", own, mass.size, least=0.0),
            "damper": tuple(self.damper) or (BACKWARD,) * len(ends),
        }
        if len(checked["damper"]) != len(ends):
            raise ValueError(f"damper has {len(checked['damper'])} elements, but there are {len(ends)} links.")
        for name, value in checked.items():
            object.__setattr__(self, name, value)

    @cached_property
    @_quietly
    def triplets(self) -> tuple[Triplets, int]:
        """The transition's entries, and the size of the state (``state.py`` says what is in it)."""
        return transition(self)

    @property
    def is_large(self) -> bool:
        """Whether some of the poles are worked out in place of all."""
        return self.triplets[1] > LARGE

    @_quietly
    def transition(self) -> Any:
        """The square matrix that takes the state at one sample to the state at the next.

        An array; of a large scene a sparse one, of scipy. ``state.py`` says what the state is.
        """
        entries, size = self.triplets
        if self.is_large:
            from hapsim.theory.network.sparse_modes import sparse_matrix

            return sparse_matrix(entries, size)
        matrix = np.zeros((size, size))
        np.add.at(matrix, (entries.row, entries.column), entries.value)
        return matrix

    @cached_property
    @_quietly
    def solution(self) -> Solution:
        """The poles and modes: all of them, or of a large scene some, and how they were found."""
        size = self.triplets[1]
        if not np.isfinite(self.triplets[0].value).all():
            return Solution(np.full(size, complex(np.nan, np.nan)), [], size)
        if self.is_large:
            from hapsim.theory.network.sparse_modes import some_modes

            return some_modes(self)
        poles, vectors = np.linalg.eig(self.transition())
        poles = snapped(self, poles.astype(complex))
        return Solution(sort_by_modulus(poles), modes_of(self, poles, vectors), size)

    def poles(self) -> Complexes:
        """Eigenvalues (n,) of the transition, by decreasing modulus; some are zero, memories.

        All of them, or of a large scene those that were worked out.
        """
        return self.solution.poles.copy()

    def spectral_radius(self) -> float:
        """The largest modulus of a pole, of those worked out; 0 for a scene without points."""
        return float(np.abs(self.solution.poles).max(initial=self.solution.growth))

    def modes(self) -> list[Mode]:
        """The scene's motions, the slowest to decay first; without the poles at zero, which are memories.

        Empty where the transition is not finite. Of a large scene those that were worked out.
        """
        return list(self.solution.modes)

    def is_stable(self) -> bool:
        """Whether every motion dies out, as far as the poles were worked out; at the limit it does not."""
        return self.spectral_radius() < 1.0 - AT_THE_LIMIT

    def how(self) -> str:
        """In words, what was worked out of a large scene's poles; "" where all were."""
        return self.solution.how

    @cached_property
    def _margins(self) -> tuple[list[Margin], str]:
        return margins_of(self)

    def margins(self) -> list[Margin]:
        """By how much each link may be stiffer, or damp more, before the scene becomes unstable (L,)."""
        return list(self._margins[0])

    def how_margins(self) -> str:
        """In words, which margins were worked out and how surely; "" for every one, between all poles."""
        return self._margins[1]
