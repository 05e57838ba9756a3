"""Measured numbers, one per record, from which tables, pictures and files are made."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass

C, COMPILED, PORTABLE, CYCLICTEST = "C loop", "compiled loop", "portable loop", "cyclictest"
NO_LOAD, BUSY, GARBAGE = "idle", "busy thread", "collecting thread"
ORDINARY, FIFO = "ordinary", "SCHED_FIFO"


@dataclass(frozen=True)
class Case:
    """Conditions of a comparison: one row of a part's table."""

    part: str
    load: str = NO_LOAD
    rate_hz: int = 0
    """0 where the loop goes as fast as it can."""
    scheduling: str = ORDINARY


@dataclass(frozen=True)
class Record:
    """One number. `value` is in the unit that the quantity's name ends with."""

    case: Case
    round: int
    peer: str
    quantity: str
    value: float


def as_row(record: Record) -> dict[str, object]:
    """Returns the row of a record in a file."""
    return {**asdict(record.case), "round": record.round, "peer": record.peer} | {
        "quantity": record.quantity,
        "value": record.value,
    }


def from_row(row: dict[str, object]) -> Record:
    """The reverse of `as_row`."""
    case = Case(**{name: row[name] for name in ("part", "load", "rate_hz", "scheduling")})  # type: ignore[arg-type]
    return Record(case, int(str(row["round"])), str(row["peer"]), str(row["quantity"]), float(str(row["value"])))


class Records:
    """All records of a run."""

    def __init__(self, records: Sequence[Record] = ()) -> None:
        self.all = list(records)

    def add(self, case: Case, number: int, peer: str, values: dict[str, float | None]) -> None:
        """Notes what one peer did in one round; what is None was not to be had."""
        self.all += [Record(case, number, peer, name, float(v)) for name, v in values.items() if v is not None]

    def cases(self, part: str) -> list[Case]:
        """The cases of a part, in the order in which they were measured first."""
        return list(dict.fromkeys(record.case for record in self.all if record.case.part == part))

    def by_round(self, case: Case, peer: str, quantity: str) -> dict[int, float]:
        """Round -> value."""
        wanted = (case, peer, quantity)
        return {r.round: r.value for r in self.all if (r.case, r.peer, r.quantity) == wanted}

    def values(self, case: Case, peer: str, quantity: str) -> list[float]:
        """One value a round."""
        return list(self.by_round(case, peer, quantity).values())

    def ratios(self, case: Case, one: str, other: str, quantity: str) -> list[float]:
        """`one` over `other`, of each round in which both were measured and the other is not 0."""
        mine, theirs = self.by_round(case, one, quantity), self.by_round(case, other, quantity)
        return [mine[r] / theirs[r] for r in mine if theirs.get(r)]


def spread(values: Sequence[float], form: str) -> str:
    """Median, and the range in brackets; a dash where nothing was measured."""
    if not values:
        return "–"
    return f"{statistics.median(values):{form}} [{min(values):{form}}, {max(values):{form}}]"
