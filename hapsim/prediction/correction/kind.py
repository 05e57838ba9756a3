"""What a correction is: how the loop looks to the hand with it, and what the scene's links become for it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from hapsim.scene.choices import CorrectionName, DamperScheme
from hapsim.theory import Configuration
from hapsim.theory.arrays import Complexes, Floats
from hapsim.theory.correction import SLOWEST


class ClosedLoop(Protocol):
    """A hand on a spring and damper, whose mass may differ from what the correction was made for."""

    def poles(self, K: ArrayLike, B: ArrayLike) -> Complexes:
        """(..., N) in the z-plane, by decreasing modulus."""

    def equivalent(self, K: ArrayLike, B: ArrayLike) -> tuple[Floats, Floats]:
        """The (k, b) that it feels, N/m and N·s/m; NaN where none is equivalent."""


class Observer(NamedTuple):
    """How a predictor follows the hand that pushes, and what it makes of the push."""

    pole: float = SLOWEST
    """Of ``state_predictor``."""
    compliance: float = 0.0
    """m/N: by so much of the push the scene sees the device further."""
    static: float | Floats | None = None
    """N/m: in place of the compliance, the stiffness that a steady push is to meet, whatever (K, B) are simulated."""
    senses: bool = False
    """Whether it reads velocities."""


class CorrectionKind(NamedTuple):
    """One of ``device.correction``."""

    name: CorrectionName
    with_damper: DamperScheme | None
    """Where the dampers at the device take their velocity from; None: as the scene says."""
    predicts: bool
    """Whether the loop hands the scene the state in which the mass will meet the force."""
    adapts: bool
    """Whether what the force is made of follows an estimate of the mass."""
    seen_by_theory: Callable[[Configuration], Configuration]
    """The configuration whose poles the loop has where the declared mass is the true one."""
    closed: Callable[[Configuration, Configuration, Observer], ClosedLoop]
    """The loop of a true configuration, the first, with a correction that was made for another, the second."""
