"""The front, the advice and the files, of rows that were made up."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from hapsim.documents import plain
from hapsim.errors import UsageError
from hapsim.speed_accuracy.comparison import objects_named
from hapsim.speed_accuracy.results import (
    OURS,
    Row,
    cheapest_within,
    columns,
    front_of,
    fronts,
    peers_in,
    row_of_document,
    verdict,
)


def row(cost: float, error: float, method: str = "cordis", whose: str = OURS, name: str = "string-10") -> Row:
    costs = () if math.isnan(cost) else (0.9 * cost, cost, 5.0 * cost)
    return Row(name, whose, method, "double", 1000.0, "frequency", error, costs, "" if costs else "unstable")


CHEAP, MIDDLE, FINE = row(1e-4, 0.1), row(1e-3, -0.01, "rk4"), row(2.0, 1e-9, "exact")
BEATEN, UNSTABLE, PEER = row(2e-3, 0.02), row(math.nan, math.nan), row(1e-6, 1e-12, "", "C")
EVERY = [FINE, UNSTABLE, BEATEN, PEER, MIDDLE, CHEAP]


def test_the_front_is_what_nothing_beats_in_both() -> None:
    assert front_of([row for row in EVERY if row.ours]) == [CHEAP, MIDDLE, FINE]
    assert fronts(EVERY) == {("string-10", "frequency"): [CHEAP, MIDDLE, FINE]}


def test_of_two_that_cost_the_same_the_more_accurate_is_on_the_front() -> None:
    assert front_of([row(1.0, 0.2), row(1.0, 0.1)]) == [row(1.0, 0.1)]
    assert front_of([row(1.0, 0.1), row(2.0, 0.1)]) == [row(1.0, 0.1)]


def test_the_cost_is_the_median_of_the_rounds() -> None:
    assert MIDDLE.cost == 1e-3
    assert math.isnan(UNSTABLE.cost)


def test_the_advice_is_the_cheapest_within_that_is_faster_than_real_time() -> None:
    assert cheapest_within(EVERY, 0.05) == MIDDLE
    assert cheapest_within(EVERY, 1e-6) is None
    (one,) = objects_named(["string-10"])
    sentence = verdict(one, EVERY)
    assert "on the front cordis (double), rk4 (double), exact (double)" in sentence
    assert "none within 0.001 in real time" in sentence
    assert "1 not shown (unstable)" in sentence


def test_rows_come_back_from_a_file_and_only_the_peers_are_taken(tmp_path: Path) -> None:
    path = tmp_path / "rows.json"
    path.write_text(json.dumps({"rows": [plain(row) for row in EVERY]}), encoding="utf-8")
    assert peers_in(path, ["string-10"]) == [PEER]
    assert peers_in(path, ["spring"]) == []
    assert [row_of_document(json.loads(json.dumps(plain(row)))) for row in (FINE, PEER)] == [FINE, PEER]
    assert math.isnan(row_of_document(plain(UNSTABLE)).error)


@pytest.mark.parametrize("text", ["{}", "no JSON", '{"rows": [{"cost": 1}]}', "[]"])
def test_a_file_without_rows_is_reported(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rows.json"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(UsageError, match="expected a JSON document with 'rows'"):
        peers_in(path, ["spring"])


def test_the_columns_mark_who_is_on_the_front() -> None:
    table = columns(EVERY, front_of([row for row in EVERY if row.ours]))
    assert table["on_front"] == [True, False, False, False, True, True]
    assert len({len(column) for column in table.values()}) == 1
