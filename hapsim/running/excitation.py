"""Pushes on a hand, to ring it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Excitation:
    """Pushes on one channel, for `ticks` samples every `every` samples from sample `start` on, to one side and to the
    other in turn: from `force` in N down to half of it, each different. They pass the guards like any force.
    `first`: one at the very beginning too."""

    channel: int
    force: float
    ticks: int
    every: int
    start: int
    first: bool
