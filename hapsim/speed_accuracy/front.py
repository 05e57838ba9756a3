"""The front: the rows that no other row beats in cost and in error at once."""

from __future__ import annotations

from collections.abc import Iterable

from hapsim.speed_accuracy.rows import Row


def front_of(rows: Iterable[Row]) -> list[Row]:
    """Of rows of one quantity of one object, from the cheapest to the most accurate; rows without a place are left
    out. Of rows that cost the same and are as far off, the first."""
    chosen: list[Row] = []
    for row in sorted((row for row in rows if row.good), key=lambda row: (row.cost, row.off)):
        if not chosen or row.off < chosen[-1].off:
            chosen.append(row)
    return chosen


def fronts(rows: Iterable[Row]) -> dict[tuple[str, str], list[Row]]:
    """(object, quantity) -> its front, hapsim's own rows only."""
    groups: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        if row.ours:
            groups.setdefault((row.object, row.quantity), []).append(row)
    return {group: front_of(members) for group, members in groups.items()}


def cheapest_within(rows: Iterable[Row], error: float) -> Row | None:
    """hapsim's own row that costs least among those that are within `error` and faster than real time."""
    able = [row for row in rows if row.ours and row.good and row.off <= error and row.cost < 1.0]
    return min(able, key=lambda row: row.cost, default=None)
