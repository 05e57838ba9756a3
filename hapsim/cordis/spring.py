"""The spring (CORDIS: RES).

F[n] = K d[n]      pulls the ends together; d: first end minus second
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hapsim.compiled import inlined
from hapsim.cordis.acting import pulls
from hapsim.cordis.kind import Column, Frame, Kind, all_of
from hapsim.cordis.link import Ends, ends_of, pull_ends, stretch
from hapsim.scene import Spring


class Springs(NamedTuple):
    """L springs: K in N/m, shape (L,)."""

    ends: Ends
    stiffness: Column


def _live(springs: Sequence[Spring], _rate: float) -> list[list[float]]:
    """K."""
    return [[one.stiffness for one in springs]]


def _build(springs: Mapping[str, Spring], columns: Sequence[Column], frame: Frame) -> Springs:
    return Springs(ends_of(list(springs.values()), frame), *columns)


SPRING = Kind(
    all_of(Spring),
    _build,
    _live,
    name="springs",
    compiled_as="gathered through unsigned indices; no previous positions are read",
    forgets=True,
)


@pulls(Springs)
@inlined
def pull_springs(group, moment):
    """Adds the force of every spring."""
    for i in range(group.stiffness.size):
        pull_ends(group.ends, i, group.stiffness[i] * stretch(group.ends, i, moment.position), moment.force)
