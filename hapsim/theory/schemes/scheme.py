"""What is known of a scheme, and what it has to say of itself: nobody who works with schemes asks for their names."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hapsim.theory.arrays import Floats


class LinkNature(NamedTuple):
    """What a scheme looks at of a link, to take it inside.

    Attributes:
        in_a_matrix: it is a spring and a backward damper and nothing else.
        memoryless: its force is one of where its ends are and how fast they go, and of nothing before.
        at_channel: one of its ends is a device channel.
    """

    in_a_matrix: bool
    memoryless: bool
    at_channel: bool


Inside = Callable[[LinkNature], bool]
"""Whether a link is inside: asked for its force between two samples. That of others is held from sample to sample."""


def in_a_matrix(link: LinkNature) -> bool:
    """Inside of a scheme that works the scene into a matrix, once."""
    return link.in_a_matrix and not link.at_channel


def at_every_instant(link: LinkNature) -> bool:
    """Inside of a scheme that asks for forces at several instants of a sample period."""
    return link.memoryless


@dataclass(frozen=True)
class Polynomial:
    """A large scene's transition is what `advance` makes of sparse matrices: it has to be made of sums and products."""


@dataclass(frozen=True)
class Implicit:
    """It is sparse on either side: (1 - share A T) z[n+1] = (1 + (1 - share) A T) z[n]."""

    share: float


@dataclass(frozen=True)
class ByModes:
    """It is full, and worked out mode by mode: `advance` has to take rates (..., N, N), each system by itself."""


class Advance(NamedTuple):
    """How a scheme moves whatever has rates of change, which links it does that with, and how where these are many.

    Attributes:
        advance: what becomes in a sample of any z whose rates of change are A z: (N, N) T A, (N, n) of several z ->
            (N, n).
        inside: `in_a_matrix`, `at_every_instant`, or another. Has to be as the kernel does it.
        large: of a large scene.
    """

    advance: Callable[[Any, Any], Any]
    inside: Inside
    large: Polynomial | Implicit | ByModes

    def __call__(self, rates: Any, start: Any) -> Any:
        return self.advance(rates, start)


class SchemeModel(NamedTuple):
    """A scheme.

    Attributes:
        step: (n,) masses in kg, (n, n) K in N/m, (n, n) B in N·s/m, T in s -> the matrix (2 n, 2 n) that takes (x, v)
            from sample to sample.
        stiffness_limit: m in kg, B in N·s/m, T in s -> N/m, the stiffness of a single oscillator up to which it is
            stable; infinity where it always is, 0 where it is at none.
        order: p, and error: c, of the frequency that a weakly damped oscillator has: omega (1 + c (omega T)^p) for
            small omega T. 0 both where it is the true one.
        advance: None of a scheme that is CORDIS's, m/T² (x[n+1] - 2 x[n] + x[n-1]) = F[n] of every mass.
    """

    step: Callable[[Floats, Floats, Floats, float], Floats]
    stiffness_limit: Callable[[float, float, float], float]
    order: int
    error: float
    advance: Advance | None


def spectral_radius(step: Floats) -> float:
    """The largest modulus of an eigenvalue: how fast the slowest motion to decay goes, a sample."""
    return float(np.abs(np.linalg.eigvals(step)).max(initial=0.0))


def rates(mass: Floats, stiffness: Floats, damping: Floats) -> Floats:
    """(2 n, 2 n): what makes the rates of change of (x, v) out of it."""
    n = mass.size
    zero, one = np.zeros((n, n)), np.eye(n)
    return np.block([[zero, one], [-stiffness / mass[:, None], -damping / mass[:, None]]])


def step_by(advance: Callable[[Any, Any], Any]) -> Callable[[Floats, Floats, Floats, float], Floats]:
    """The ``step`` of a scheme that advances anything."""

    def step(mass: Floats, stiffness: Floats, damping: Floats, period: float) -> Floats:
        return np.asarray(advance(period * rates(mass, stiffness, damping), np.eye(2 * mass.size)), float)

    return step


def always_stable(_mass: float, _damping: float, _period: float) -> float:
    """The limit of a scheme that has none."""
    return float("inf")
