"""Results of a peer for a string, as one row of a table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from hapsim.speed_accuracy.strings import StringOfMasses
from speed.peers.peer import Peer


def row_of(peer: Peer, string: StringOfMasses, rate: float, modes: Sequence[int], rounds: int) -> dict[str, Any]:
    """{peer, masses, rate_hz, precision, cost_s_per_s, frequencies_hz, errors, preparation_s, note}.

    `errors` are relative to the string in continuous time. Where a frequency is NaN it is None here, and where all are
    the cost is not measured.
    """
    row = {"peer": peer.name, "masses": string.masses, "rate_hz": rate, "precision": peer.precision}
    if reason := peer.available():
        return row | _figures([], string, [], []) | {"preparation_s": None, "note": reason}
    found = peer.frequencies(string, rate, modes)
    unstable = all(math.isnan(value) for value in found)
    gave_up = unstable and peer.preparation_s is None and bool(peer.note)
    costs = [] if unstable else peer.cost(string, rate, rounds)
    note = "; ".join(part for part in ("unstable" if unstable and not gave_up else "", peer.note) if part)
    return row | _figures(costs, string, modes, found) | {"preparation_s": peer.preparation_s, "note": note}


def _figures(
    costs: list[float], string: StringOfMasses, modes: Sequence[int], found: Sequence[float]
) -> dict[str, list[Any]]:
    errors = [value / string.frequency(mode) - 1.0 for mode, value in zip(modes, found, strict=True)]
    return {"cost_s_per_s": costs, "frequencies_hz": _finite(found), "errors": _finite(errors)}


def _finite(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]
