"""What was found, a row each: what a method makes of an object at a rate."""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from hapsim.errors import UsageError

OURS = "hapsim"


@dataclass(frozen=True)
class Row:
    """One quantity of one object, simulated by one method in one precision at one rate."""

    object: str
    whose: str
    """`OURS`, or the peer's name."""
    method: str
    precision: str
    rate_hz: float
    quantity: str
    error: float
    """Relative to the continuous object, with its sign; NaN where there is none."""
    costs: tuple[float, ...] = ()
    """Seconds of processor time for a simulated second, one for each round; none where there is no error."""
    note: str = ""
    """Why there is no error, or what else there is to say."""

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
        """Whether it has a place in a picture."""
        return math.isfinite(self.error) and math.isfinite(self.cost)

    @property
    def ours(self) -> bool:
        return self.whose == OURS

    def as_document(self) -> dict[str, Any]:
        """For JSON: what there is not is null."""
        error = self.error if math.isfinite(self.error) else None
        return asdict(self) | {"error": error, "costs": list(self.costs)}


def row_of_document(document: Any) -> Row:
    """The reverse of `Row.as_document`. Raises TypeError or ValueError where it is none."""
    row = Row(**document)
    error = math.nan if row.error is None else float(row.error)
    return replace(row, error=error, rate_hz=float(row.rate_hz), costs=tuple(float(cost) for cost in row.costs))


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
        "object": [row.object for row in rows],
        "whose": [row.whose for row in rows],
        "method": [row.method for row in rows],
        "precision": [row.precision for row in rows],
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
