"""The vocabulary in which holds and samplings are written, one a file.

Each is described twice, and the two descriptions are read by different codes on purpose: its ``terms`` by the
modified z-transform (``plant.py``), its behaviour in time by the state space (``device_step.py``). That the
two agree is a test of both. To add one: a file beside ``hold_zoh.py`` and a line in a table of
``interface.py``.
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

    ``segments`` is given the fraction of a sample period, 0 <= fraction < 1, by which a new force comes after
    a sample.
    """

    terms: tuple[Term, ...]
    segments: Callable[[float], list[Segment]]


class Sampling(NamedTuple):
    """How a motion becomes a number: its terms, and whether it is the mean over the period just ended."""

    terms: tuple[Term, ...]
    reads_mean: bool


def product(one: tuple[Term, ...], other: tuple[Term, ...]) -> tuple[Term, ...]:
    """The terms of two transfer functions in series."""
    return tuple(Term(a.weight * b.weight, a.lag + b.lag, a.integrations + b.integrations) for a in one for b in other)
