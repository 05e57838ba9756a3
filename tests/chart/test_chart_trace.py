"""`hapsim chart trace`: a record, what is left of one, and a report file."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart import recorded
from hapsim.loop.trace import Trace
from hapsim.running import run
from hapsim.scene import load_scene

Chart = Callable[..., Any]


@pytest.fixture
def trace(scene_file: Callable[..., Path], tmp_path: Path) -> Trace:
    return run(load_scene(scene_file("spring")), duration=2.0, record=tmp_path / "t.trace")


def test_a_record_is_drawn_and_its_numbers_are_those_recorded(chart: Chart, trace: Trace, tmp_path: Path) -> None:
    answer = chart("trace", tmp_path / "t.trace", "--picture", "p.svg", "--data", "d.csv", "--last", 0.5)
    assert answer.status == 0
    assert "501 of 2000 ticks, done" in answer.out
    assert Path("p.svg").read_bytes().startswith(b"<?xml")
    with Path("d.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    np.testing.assert_allclose([float(row["position_m[0]"]) for row in rows], trace.position[-501:, 0], rtol=1e-11)
    np.testing.assert_allclose([float(row["force_N[0]"]) for row in rows], trace.force[-501:, 0], rtol=1e-11)
    np.testing.assert_allclose([float(row["time_s"]) for row in rows], np.arange(501) * 1e-3, atol=1e-12)


def test_what_is_left_of_a_record_is_drawn_as_far_as_it_goes(chart: Chart, trace: Trace, tmp_path: Path) -> None:
    whole = (tmp_path / "t.trace").read_bytes()
    (tmp_path / "t.npz.part").write_bytes(whole[:-1])
    document = chart("trace", tmp_path / "t.npz.part", "--json", "--picture", "p.png").document
    assert document["rows"] == trace.sample.size
    assert document["report"]["ending"] == "not finished: the record stops after 2000 ticks"


@pytest.mark.parametrize("words", [["--last", "0"], ["--last", "nan"]])
def test_what_cannot_be_drawn_is_status_2(chart: Chart, trace: Trace, tmp_path: Path, words: list[str]) -> None:
    trace.since(trace.sample.size).save(tmp_path / "empty.npz")
    assert "no row" in chart("trace", tmp_path / "empty.npz").sentence
    answer = chart("trace", tmp_path / "t.trace", *words)
    assert answer.status == 2
    assert "--last" in answer.sentence


def test_no_peak_is_lost_where_not_every_row_is_drawn() -> None:
    values = np.zeros(1_000_000)
    values[[123_456, 777_777]] = 1.0, -1.0
    drawn = recorded._least_and_greatest(values)
    assert {123_456, 777_777} <= set(drawn.tolist())
    assert drawn.size <= 4000
