"""Objects and results of a comparison: rows, the front, a verdict."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from hapsim.errors import UsageError
from hapsim.scene import Scene

OURS = "hapsim"
WITHIN = 1e-3


class Found(NamedTuple):
    """The result of a run: how far each quantity is off, relative to the continuous object, with its sign."""

    errors: dict[str, float]
    why_not: str = ""  # in words, where there is none


class Object(Protocol):
    """Something with a closed form in continuous time, that hapsim simulates."""

    name: str  # as the command's option has it
    title: str  # as a picture has it
    quantities: tuple[str, ...]  # what can be off
    methods: tuple[str, ...]  # by what it is simulated

    def scene(self, method: str, precision: str, rate: float) -> Scene:
        """Returns the scene to time; rate in Hz."""

    def found(self, method: str, precision: str, rate: float) -> Found:
        """Runs it."""


@dataclass(frozen=True)
class Row:
    """One quantity of one object, simulated by one method in one precision at one rate."""

    object: str
    whose: str  # `OURS`, or the peer's name
    method: str
    precision: str
    rate_hz: float
    quantity: str
    error: float  # relative to the continuous object, with its sign; NaN where there is none
    costs: tuple[float, ...] = ()
    """Seconds of processor time for a simulated second, one for each round; none where there is no error."""
    note: str = ""  # why there is no error, or a remark

    @property
    def cost(self) -> float:
        """The median; NaN where nothing was timed."""
        return statistics.median(self.costs) if self.costs else math.nan

    @property
    def off(self) -> float:
        """The error without its sign."""
        return abs(self.error)

    @property
    def good(self) -> bool:
        """True if error and cost are finite."""
        return math.isfinite(self.error) and math.isfinite(self.cost)

    @property
    def ours(self) -> bool:
        """True for a row of hapsim, not of another program."""
        return self.whose == OURS


def row_of_document(document: Any) -> Row:
    """Returns a row from its JSON object. Raises TypeError or ValueError if it is none."""
    row = Row(**document)
    error = math.nan if row.error is None else float(row.error)
    return replace(row, error=error, rate_hz=float(row.rate_hz), costs=tuple(map(float, row.costs)))


def peers_in(path: Path, objects: Iterable[str]) -> list[Row]:
    """The rows of others than hapsim that a file holds for these objects. UsageError where it holds no rows."""
    try:
        rows = [row_of_document(row) for row in json.loads(path.read_text(encoding="utf-8"))["rows"]]
    except OSError as error:
        raise UsageError(f"--with: {path} cannot be read: {error.strerror}") from None
    except (ValueError, TypeError, KeyError):
        raise UsageError(
            f"--with: {path}: expected a JSON document with 'rows', as tools/bench/schemes or --json write it"
        ) from None
    wanted = set(objects)
    return [row for row in rows if not row.ours and row.object in wanted]


def columns(rows: Sequence[Row], front: Iterable[Row]) -> dict[str, list[Any]]:
    """Every number, by the names that a data file uses: a row a row."""
    chosen = set(front)
    return {
        **{name: [getattr(row, name) for row in rows] for name in ("object", "whose", "method", "precision")},
        "rate_Hz": [row.rate_hz for row in rows],
        "quantity": [row.quantity for row in rows],
        "error": [row.error for row in rows],
        "cost_s_per_s": [row.cost for row in rows],
        "cost_least": [min(row.costs, default=math.nan) for row in rows],
        "cost_most": [max(row.costs, default=math.nan) for row in rows],
        "rounds": [len(row.costs) for row in rows],
        "on_front": [row in chosen for row in rows],
        "note": [row.note for row in rows],
    }


def front_of(rows: Iterable[Row]) -> list[Row]:
    """The rows that no other beats in cost and in error at once, from the cheapest to the most accurate.

    Of one quantity of one object, without the rows that have no place. Of rows that cost the same and are as far off,
    the first.
    """
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


def verdict(one: Object, rows: Sequence[Row]) -> str:
    """One sentence for an object, from the rows of all: what is on the front, and what to take."""
    mine = [row for row in rows if row.object == one.name]
    parts = [_of_quantity(quantity, [row for row in mine if row.quantity == quantity]) for quantity in one.quantities]
    reasons: dict[str, set[tuple[str, str, float]]] = {}
    for row in mine:
        if row.ours and not row.good and row.note:
            reasons.setdefault(row.note.split(":", 1)[0], set()).add((row.method, row.precision, row.rate_hz))
    parts += [f"{len(cases)} not shown ({reason})" for reason, cases in reasons.items()]
    return f"{one.title[0].upper()}{one.title[1:]}: {'; '.join(parts)}."


def _of_quantity(quantity: str, rows: Sequence[Row]) -> str:
    front = [row for members in fronts(rows).values() for row in members]
    if not front:
        return f"{quantity}: nothing that could be timed"
    precisions: dict[str, set[str]] = {}
    for row in front:
        precisions.setdefault(row.method, set()).add(row.precision)
    names = [f"{method} ({', '.join(sorted(lengths))})" for method, lengths in precisions.items()]
    best = cheapest_within(rows, WITHIN)
    advice = f"none within {WITHIN:g} in real time"
    if best is not None:
        advice = (
            f"cheapest within {WITHIN:g} in real time: {best.method}, {best.precision}, at {best.rate_hz:g} Hz "
            f"({best.cost:.2g} s a second, off by {best.error:+.1e})"
        )
    return f"{quantity}: on the front {', '.join(names)}; {advice}"
