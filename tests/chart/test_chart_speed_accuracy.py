"""`hapsim chart speed-accuracy`: a small selection in every form, peers on the same axes, and what is refused."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.chart.speed_accuracy import draw_speed_accuracy, looks_of
from hapsim.documents import plain
from hapsim.speed_accuracy.comparison import objects_named
from hapsim.speed_accuracy.objects import OBJECTS
from hapsim.speed_accuracy.results import OURS, Row

Chart = Callable[..., Any]
SCHEMES = ("cordis", "exact")
SMALL = ["--object", "string-10", "--scheme", "cordis,exact", "--rates", "1000,10000", "--rounds", "2"]
PEER = Row("string-10", "a peer", "", "double", 1000.0, "frequency", 1e-3, (0.1, 0.2), "")


def test_a_small_selection_gives_picture_numbers_and_a_sentence(
    chart: Chart, rows_of: Callable[[str], list[dict[str, str]]]
) -> None:
    Path("peers.json").write_text(json.dumps({"rows": [plain(PEER)]}), encoding="utf-8")
    answer = chart("speed-accuracy", *SMALL, "--with", "peers.json", "--picture", "p.png", "--data", "n.csv")
    assert answer.status == 0
    assert "A string of 10 masses: frequency: on the front" in answer.out
    assert Path("p.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of("n.csv")
    ours = [row for row in rows if row["whose"] == OURS]
    assert len(ours) == 2 * 2 * len(SCHEMES)
    assert {row["rounds"] for row in ours} == {"2"}
    assert all(float(row["cost_least"]) <= float(row["cost_s_per_s"]) <= float(row["cost_most"]) for row in rows)
    assert [row["whose"] for row in rows if row["whose"] != OURS] == ["a peer"]


def test_for_scripts_there_is_one_document(chart: Chart) -> None:
    document = chart("speed-accuracy", *SMALL, "--json").document
    assert document["objects"].keys() == {"string-10"}
    assert {row["rate_hz"] for row in document["rows"]} == {1000.0, 10_000.0}
    assert not list(Path().glob("*.svg"))


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--object", "harp"], "--object: found 'harp', expected one of spring, contact"),
        (["--scheme", "cordis,euler"], "--scheme: found 'euler', expected one of cordis, semi_implicit"),
        (["--rates", "fast"], "--rates: found 'fast', expected a number"),
        (["--rates", "0"], "--rates: found 0, expected a finite number above 0"),
        (["--rates", "nan"], "--rates: found nan, expected a finite number above 0"),
        (["--rounds", "0"], "--rounds: found 0, expected a whole number of at least 1"),
        (["--with", "nowhere.json"], "--with: nowhere.json cannot be read"),
        (["--picture", "p.gif"], "found the ending '.gif'"),
        (["--data", "n.json"], "found the ending '.json'"),
    ],
)
def test_what_cannot_be_done_is_reported_before_anything_runs(chart: Chart, words: list[str], told: str) -> None:
    answer = chart("speed-accuracy", *words)
    assert answer.status == 2
    assert told in answer.sentence


def test_the_help_names_every_object(chart: Chart) -> None:
    said = chart("speed-accuracy", "--help").out
    assert all(one.name in said for one in OBJECTS)


def test_an_object_of_which_nothing_is_stable_has_an_empty_panel(tmp_path: Path) -> None:
    rows = [Row("string-1000", OURS, "cordis", "double", 500.0, "frequency", float("nan"), (), "unstable")]
    draw_speed_accuracy(objects_named(["string-1000"]), rows, tmp_path / "p.png")
    assert (tmp_path / "p.png").exists()


def test_no_two_methods_of_any_object_share_a_colour() -> None:
    methods = {method for one in OBJECTS for method in one.methods}
    rows = [Row(one.name, OURS, method, "double", 1e3, "k", 0.1) for one in OBJECTS for method in one.methods]
    ours, _ = looks_of(OBJECTS, rows)
    assert len({look["color"] for look in ours.values()}) == len(methods) == len(ours)
