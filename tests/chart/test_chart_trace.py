"""`hapsim chart trace`: a record, what is left of one, and a report file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart import trace_chart
from hapsim.loop.ring import LATE_FORCE, LIMITED, UNSENT, WITHHELD
from hapsim.recording import stream
from hapsim.recording.trace import Trace, load_trace
from hapsim.running import run
from hapsim.scene import load_scene
from tests.one_hand import scene_of, touch

Chart = Callable[..., Any]


@pytest.fixture(scope="module")
def record(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("record") / "t.trace"
    run(scene_of({"touch": touch(2000.0, 5.0)}), duration=2.0, record=path, keep=False)
    return path


@pytest.fixture(scope="module")
def trace(record: Path) -> Trace:
    return load_trace(record)


def test_a_record_is_drawn_and_its_numbers_are_those_recorded(
    chart: Chart, record: Path, trace: Trace, columns_of: Callable[[str], dict[str, Any]]
) -> None:
    answer = chart("trace", record, "--picture", "p.svg", "--data", "d.csv", "--last", 0.5)
    assert answer.status == 0
    assert "501 of 2000 ticks, done" in answer.out
    assert Path("p.svg").read_bytes().startswith(b"<?xml")
    arrived = (trace.time_ns[-501:] - trace.time_ns[-501]) * 1e-9
    for name, expected, rtol, atol in (
        ("position_m[0]", trace.position[-501:, 0], 1e-11, 0.0),
        ("force_N[0]", trace.force[-501:, 0], 1e-11, 0.0),
        ("time_s", np.arange(1499, 2000) * 1e-3, 1e-14, 1e-12),
        ("arrived_s", arrived, 1e-9, 1e-9),
    ):
        np.testing.assert_allclose(columns_of("d.csv")[name], expected, rtol, atol)


def test_a_last_second_is_drawn_over_the_time_since_arming_and_the_axis_is_named_so(
    trace: Trace, tmp_path: Path
) -> None:
    last = trace.since(1500)
    np.testing.assert_allclose(trace_chart.seconds_of(last), last.sample / 1000.0)
    trace_chart.draw_trace(last, "the last", tmp_path / "p.svg")
    assert "time since arming (s): sample number / 1000 Hz" in (tmp_path / "p.svg").read_text("utf-8")


def test_a_withheld_force_is_marked_as_such_and_not_as_one_at_its_limit(trace: Trace, tmp_path: Path) -> None:
    flags = np.zeros_like(trace.flags)
    flags[10:18] = LIMITED | WITHHELD
    flags[20:23] = LIMITED
    flags[30:32] = UNSENT | WITHHELD
    flags[40] = WITHHELD | LATE_FORCE
    marked = trace_chart.marked_rows(replace(trace, flags=flags))
    assert {what: rows.tolist() for what, rows in marked.items()} == {
        "late": [40],
        "never sent": [30, 31],
        "withheld, zero sent": [*range(10, 18), 40],
        "at its limit": [20, 21, 22],
        "positions lost before": [],
    }
    trace_chart.draw_trace(replace(trace, flags=flags), "t", tmp_path / "p.svg")
    picture = (tmp_path / "p.svg").read_text("utf-8")
    assert "withheld, zero sent: 9" in picture
    assert "at its limit: 3" in picture


def test_the_number_of_ticks_is_printed_only_where_it_is_known(
    chart: Chart, trace: Trace, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stream, "MOST_ROWS", 500)
    trace.save(tmp_path / "t.trace")
    whole = (tmp_path / "t.trace").read_bytes()
    cut, damaged = tmp_path / "cut.trace", tmp_path / "damaged.trace"
    cut.write_bytes(whole[:-1])
    at = whole.rindex(b"ROWS") + 30
    damaged.write_bytes(whole[:at] + b"damage" + whole[at + 6 :])
    (tmp_path / "t.npz.part").write_bytes(whole[:-1])  # as a run leaves it
    document = chart("trace", tmp_path / "t.npz.part", "--json", "--picture", "p.png").document
    assert document["rows"] == trace.sample.size
    assert document["report"]["ending"] == "not finished: the record stops after 2000 ticks"
    told = [chart("trace", cut, *more, "--picture", "p.svg").out for more in ((), ("--last", 0.1))]
    assert told[0].startswith("cut.trace: not finished: the record stops after 2000 ticks")
    assert told[1].startswith("cut.trace: 101 ticks drawn; not finished: the record stops after 2000 ticks")
    of_damaged = chart("trace", damaged, "--picture", "p.svg").out
    assert of_damaged.startswith("damaged.trace: not finished: the record stops after 1500 ticks")


@pytest.mark.parametrize("words", [["--last", "0"], ["--last", "nan"]])
def test_what_cannot_be_drawn_is_status_2(chart: Chart, record: Path, trace: Trace, words: list[str]) -> None:
    trace.since(trace.sample.size).save("empty.npz")
    assert "no row" in chart("trace", "empty.npz").sentence
    answer = chart("trace", record, *words)
    assert answer.status == 2
    assert "--last" in answer.sentence


def test_the_axis_is_that_of_the_data_and_has_zero_only_where_they_are_near(trace: Trace, tmp_path: Path) -> None:
    wave = np.round(1000.0 * np.sin(0.1 * trace.sample)).astype(np.int64)[:, None]
    for shift, has_zero in ((0, 1), (100_000, 0)):
        axes: list[Any] = []
        moved = replace(trace, position_counts=wave + shift)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(trace_chart, "draw_zero_if_near", axes.append)
            trace_chart.draw_trace(moved, "t", tmp_path / "p.svg")
        assert np.ptp(axes[0].lines[0].get_ydata()) == pytest.approx(1e3 * np.ptp(moved.position[:, 0]))  # every peak
        drawn = len(axes[0].lines)
        trace_chart.draw_zero_if_near(axes[0])
        assert len(axes[0].lines) - drawn == has_zero
        low, high = axes[0].get_ylim()
        assert high - low < 1.2e3 * float(np.ptp(moved.position[:, 0]))


def test_the_path_of_a_hand_in_the_plane_is_drawn_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    trace = run(load_scene("disc"), duration=0.3, record=tmp_path / "t.npz")
    drawn: list[Any] = []
    monkeypatch.setattr(trace_chart, "legend_below", lambda figure, _: drawn.extend(figure.axes))
    trace_chart.draw_trace(load_trace(tmp_path / "t.npz"), "t", tmp_path / "p.svg")
    path = next(axes for axes in drawn if axes.get_label() == "path")
    np.testing.assert_allclose(path.lines[0].get_xydata(), 1e3 * trace.position, rtol=1e-9)
    np.testing.assert_allclose(path.lines[1].get_xydata(), 1e3 * trace.position[:1], rtol=1e-9)
    assert path.get_aspect() == 1.0
    drawn.clear()
    trace_chart.draw_trace(replace(trace, report=replace(trace.report, in_plane=())), "t", tmp_path / "p.svg")
    assert len(drawn) == 2, "a line has no path"
