"""One sentence for each object: what is on the front, and what to take."""

from __future__ import annotations

from collections.abc import Sequence

from hapsim.speed_accuracy.compared import Object
from hapsim.speed_accuracy.front import cheapest_within, fronts
from hapsim.speed_accuracy.rows import Row

WITHIN = 1e-3


def verdict(one: Object, rows: Sequence[Row]) -> str:
    """For a person; `rows` of all objects."""
    mine = [row for row in rows if row.object == one.name]
    parts = [_of_quantity(quantity, [row for row in mine if row.quantity == quantity]) for quantity in one.quantities]
    lost = _lost(mine)
    return f"{one.title[0].upper()}{one.title[1:]}: {'; '.join(parts)}{lost}."


def _of_quantity(quantity: str, rows: Sequence[Row]) -> str:
    front = [row for members in fronts(rows).values() for row in members]
    if not front:
        return f"{quantity}: nothing that could be timed"
    precisions: dict[str, dict[str, None]] = {}
    for row in front:
        precisions.setdefault(row.method, {})[row.precision] = None
    names = [f"{method} ({', '.join(sorted(lengths))})" for method, lengths in precisions.items()]
    best = cheapest_within(rows, WITHIN)
    if best is None:
        advice = f"none within {WITHIN:g} in real time"
    else:
        advice = (
            f"cheapest within {WITHIN:g} in real time: {best.method}, {best.precision}, at {best.rate_hz:g} Hz "
            f"({best.cost:.2g} s a second, off by {best.error:+.1e})"
        )
    return f"{quantity}: on the front {', '.join(names)}; {advice}"


def _lost(rows: Sequence[Row]) -> str:
    """How many cases have no place, by the reason."""
    reasons: dict[str, set[tuple[str, str, float]]] = {}
    for row in rows:
        if row.ours and not row.good and row.note:
            reasons.setdefault(row.note.split(":", 1)[0], set()).add((row.method, row.precision, row.rate_hz))
    return "".join(f"; {len(cases)} left out ({reason})" for reason, cases in reasons.items())
