"""What a record shows of the device: positions, the forces that were sent, and where it moved to one side."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hapsim.loop.ring import BRIDGED, LATE_FORCE, OFF_GRID
from hapsim.measuring.converters import Floats
from hapsim.measuring.trace_quality import ROUNDING, unbroken
from hapsim.recording.trace import Trace

_CERTAIN = 6.0  # standard deviations: a velocity of which the sign is known
_SLOW = 0.03  # of the largest velocity: what is slower may be about to turn
_LEAST_ROWS = 8
_REACHES = (1, 2, 4, 8, 16, 32, 64)  # rows to either side
_APART = 0.06  # of a swing: much longer than it takes from the least velocity to twice that
_CLEARLY = 4.0  # times the least velocity, in a swing that counts


@dataclass(frozen=True)
class Motion:
    """One channel of a record: `position` in counts from where the device was found, `force` in N, row by row."""

    position: Floats
    force: Floats
    known: tuple[tuple[int, int], ...]
    """Index ranges in which every force that acts was recorded."""


class Swing(NamedTuple):
    """Rows `first` to `last` of a motion: the velocity keeps its sign, `side` 1 or -1; or it may not, `side` 0."""

    motion: int
    first: int
    last: int
    side: float

    @property
    def rows(self) -> int:
        """How many."""
        return self.last - self.first


def motion_of(trace: Trace, channel: int, home_counts: float, most_delay: float) -> Motion:
    """`most_delay`: in sample periods; after a gap, forces that are unknown act in that many rows."""
    lead = math.ceil(most_delay) + 2
    runs = unbroken(trace, LATE_FORCE | BRIDGED | OFF_GRID)
    known = [(first + (lead if first > 0 else 0), last) for first, last in runs]  # before the first row no force acted
    position = trace.position_counts[:, channel].astype(np.float64) - home_counts
    force = trace.force_counts[:, channel].astype(np.float64) * float(trace.force_scale[channel])
    return Motion(position, force, tuple((begin, last) for begin, last in known if last - begin >= _LEAST_ROWS))


def swings_of(motions: list[Motion], noise_counts: float) -> list[Swing]:
    """Where the velocity is known to keep its sign, with a margin on either side. `noise_counts`: of a position, rms;
    the rounding is added. The velocity is one over as many rows as leave most of the record."""
    noise = math.hypot(noise_counts, ROUNDING)
    speeds = [np.abs(_velocity(motion.position[first:last], 2)) for motion in motions for first, last in motion.known]
    fastest = max((float(np.quantile(speed, 0.99)) for speed in speeds if speed.size), default=0.0)
    if fastest == 0.0:
        return []
    found = (
        [swing for i, motion in enumerate(motions) for swing in _swings(i, motion, reach, noise, fastest)]
        for reach in _REACHES
    )
    return max(found, key=lambda swings: sum(swing.rows for swing in swings))


def pieces_of(motions: list[Motion], rows: int) -> list[Swing]:
    """All that is known of the motions, whatever the velocity, in pieces of at most `rows` rows."""
    return [
        Swing(i, begin, min(begin + rows, last), 0.0)
        for i, motion in enumerate(motions)
        for first, last in motion.known
        for begin in range(first, last - _LEAST_ROWS, rows)
    ]


def _velocity(position: Floats, reach: int) -> Floats:
    """Counts per sample from `reach` rows on either side; these are missing at either end."""
    return (position[2 * reach :] - position[: -2 * reach]) / (2.0 * reach)


def _swings(number: int, motion: Motion, reach: int, noise: float, fastest: float) -> Iterator[Swing]:
    least = max(_CERTAIN * noise / (math.sqrt(2.0) * reach), _SLOW * fastest)
    for first, last in motion.known:
        speed = _velocity(motion.position[first:last], reach)
        for side in (1.0, -1.0):
            moves = side * speed > least
            edges = np.flatnonzero(np.diff(moves.astype(np.int8), prepend=0, append=0))
            for begin, end in edges.reshape(-1, 2):
                # A velocity is a mean over its rows: only what lies so far inside keeps the sign for sure. And whose
                # noise had a say in where the swing begins must not be in it, or what is left would not be noise.
                apart = 1 + math.ceil(_APART * (end - begin))
                inner = Swing(number, first + begin + 2 * reach + apart, first + end - apart, side)
                if inner.rows >= _LEAST_ROWS and float(np.max(side * speed[begin:end])) > _CLEARLY * least:
                    yield inner
