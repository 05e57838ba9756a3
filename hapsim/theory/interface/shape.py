"""The vocabulary in which holds, samplings and dampers are written, one a file.

Each is described twice, and the two descriptions are read by different codes on purpose: its transfer function by the
characteristic equation (``plant.py``, ``loop_equation.py``), its behaviour in time by the state space
(``device_step.py``, ``state.py``). That the two agree is a test of both. To add one: a file beside ``hold_zoh.py``
or ``damper_backward.py`` and a line in a table of ``interface.py``; a damper has besides its recurrence in the kernel.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple


class Term(NamedTuple):
    """One term ``weight · exp(-lag s) / s^integrations`` of a transfer function, time in sample periods."""

    weight: float
    lag: int
    integrations: int


class Segment(NamedTuple):
    """A part of one sample period, during which nothing changes but at its beginning.

    ``duration`` is in sample periods. ``kick`` and ``constant`` are the age, in whole samples beyond the
    delay's own, of the computed force that strikes as an impulse at the beginning, or acts throughout; None
    where there is none.
    """

    duration: float
    kick: int | None = None
    constant: int | None = None


class Hold(NamedTuple):
    """How a computed force becomes a force in time: its terms, and what it does in one sample period.

    ``lag`` is its mean delay in sample periods, what it costs a slow motion.

    ``segments`` is given the fraction of a sample period, 0 <= fraction < 1, by which a new force comes after
    a sample.
    """

    terms: tuple[Term, ...]
    lag: float
    segments: Callable[[float], list[Segment]]


class Sampling(NamedTuple):
    """How a motion becomes a number: its terms, its mean delay, and whether it is the mean over the period."""

    terms: tuple[Term, ...]
    lag: float
    reads_mean: bool


class Damper(NamedTuple):
    """How readings become the velocity that a link's damping acts on, in metres per sample period.

    As a transfer function, v/y = w ``numerator``(w)/(``denominator``(w) z^``delays``), in powers of w = z - 1, the
    lowest first; both have the same value at w = 0, so that a slow motion's velocity is true. As a recurrence,
    v[n] is the sum of ``of_positions`` over y[n], y[n-1], ... and of ``of_velocities`` over v[n-1], v[n-2], ...
    Where it ``senses``, the velocity of the device's end is read from the device instead, and both stand for the
    other end alone.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...]
    delays: int
    of_positions: tuple[float, ...]
    of_velocities: tuple[float, ...]
    senses: bool = False


def product(one: tuple[Term, ...], other: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms of two transfer functions in series."""
    return tuple(Term(a.weight * b.weight, a.lag + b.lag, a.integrations + b.integrations) for a in one for b in other)
