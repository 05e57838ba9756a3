"""The damper (CORDIS: FRO), by the backward difference.

F[n] = (B/T) (d[n] - d[n-1])      pulls the ends together; d: first end minus second
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.kind import Column, Frame, Kind, all_of
from hapsim.cordis.link import Ends, ends_of, pull_ends, stretch
from hapsim.scene import Damper


class Dampers(NamedTuple):
    """L dampers: B/T in N/m, shape (L,)."""

    ends: Ends
    damping_per_sample: Column


def _live(dampers: Sequence[Damper], rate: float) -> list[list[float]]:
    """B/T."""
    return [[one.damping * rate for one in dampers]]


def _build(dampers: Mapping[str, Damper], columns: Sequence[Column], frame: Frame) -> Dampers:
    return Dampers(ends_of(list(dampers.values()), frame), *columns)


DAMPER = Kind(
    all_of(Damper),
    _build,
    _live,
    name="dampers",
    compiled_as="gathered through unsigned indices; no stiffness is carried",
    forgets=True,
)


@pulls(Dampers)
@inlined
def pull_dampers(group, moment):
    """Adds the force of every damper."""
    for i in range(group.damping_per_sample.size):
        growth = stretch(group.ends, i, moment.position) - stretch(group.ends, i, moment.previous)
        pull_ends(group.ends, i, group.damping_per_sample[i] * growth, moment.force)
