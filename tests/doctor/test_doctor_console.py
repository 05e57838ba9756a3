"""Output of the doctor: histograms as bars, an examination as text and as a document."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from rich.console import Console

from hapsim.chart.steadiness import columns, draw_steadiness, steadiness
from hapsim.cli.doctor import examination_document, histogram_lines, histogram_rows, now, show_examination
from hapsim.cli.live import live_words
from hapsim.cli.output import document
from hapsim.doctor.advice import Advice, Load, Machine
from hapsim.doctor.examine import Examination, Step
from hapsim.doctor.exchanges import IN_TIME, MOCK, ON_THE_MOCK, Exchanges, verdict_on
from hapsim.documents import plain
from hapsim.loop.histogram import Histogram
from hapsim.loop.realtime import PrivilegeResult
from hapsim.number_format import short_duration

Counted = Callable[[dict[float, int]], Histogram]
MACHINE = Machine("Some [bold] Processor", 2, 4, "6.12", False, ("powersave",), "tsc", "QEMU", True, "3")
COMMAND = "a command that is to be copied, and is longer than any line of a terminal of eighty columns, [literally]"


@pytest.fixture
def examination(histogram: Counted, report: Callable[..., Any]) -> Examination:
    late = histogram({20e-6: 1000, 80e-6: 10, 3e-3: 1})
    ran = (
        Exchanges(1000.0, "device", MOCK, report(), late, late),
        Exchanges(4000.0, "device", MOCK, None, None, None, "the mock is gone"),
        Exchanges(1000.0, "host", MOCK, report(deadline_misses=30), late, histogram({})),
    )
    return Examination(
        scene="a scene.yaml",
        rate_hz=1000.0,
        seconds=2.0,
        machine=MACHINE,
        grants=(PrivilegeResult("SCHED_FIFO", True, "priority 80"), PrivilegeResult("memory locked", False, "a limit")),
        wakeups={1000.0: late, 4000.0: histogram({})},
        exchanges=ran,
        verdicts=tuple(map(verdict_on, ran)),
        load=Load(0.5, 0.01, None),
        advice=(Advice("Found.", "Why.", "Do:", (COMMAND,)), Advice("Also.", "Because.", " ".join(["So."] * 60))),
    )


def shown(examination: Examination, width: int = 80, encoding: str = "utf-8") -> str:
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, errors="strict")
    show_examination(Console(file=stream, width=width, highlight=False), examination)
    stream.flush()
    raw: Any = stream.buffer
    return str(raw.getvalue().decode(encoding))


def test_a_long_path_of_a_scene_stays_whole(examination: Examination) -> None:
    path = f"/home/[me]/{'a-directory/' * 8}a_scene.yaml"
    told = shown(replace(examination, scene=path)).splitlines()
    assert path in told
    assert "on the mock; clock: device" in told


@pytest.mark.parametrize("width", [80, 120])
def test_no_line_is_wider_than_the_terminal_but_a_command(examination: Examination, width: int) -> None:
    lines = shown(examination, width).splitlines()
    assert [line.strip() for line in lines if len(line) > width] == ([COMMAND] if len(COMMAND) + 6 > width else [])


def test_an_examination_is_reported_in_full(examination: Examination) -> None:
    text = shown(examination, 200)
    for words_of_it in (
        "Some [bold] Processor; 2 of 4 cores (two threads a core)",
        "; Linux 6.12, not a real-time kernel; clock tsc; ",
        "SCHED_FIFO: granted, priority 80",
        "memory locked: denied",
        "With clock: device this machine keeps up to 1 kHz.",
        "With clock: host this machine keeps none of these rates without gaps.",
        "1 kHz: yes, 100 % in time; 4 kHz: no verdict (the mock is gone).",
        "1 kHz: with gaps, 97.0 % in time.",
        "In time: the device had the force when it needed it",
        "In time: the loop woke up less than a period late",
        " 1. Found.\n    Why. Do:\n      a command",
        " 2. Also.\n    Because. So. So.",
    ):
        assert words_of_it in text
    unwrapped = " ".join(text.split())
    assert f"{IN_TIME['device']} {ON_THE_MOCK}" in unwrapped
    assert unwrapped.count(ON_THE_MOCK) == 1


def alone(examination: Examination, run: Exchanges) -> str:
    """Returns the text of an examination with this run alone."""
    return shown(replace(examination, exchanges=(run,), verdicts=(verdict_on(run),), advice=()), 200)


def test_the_report_states_that_a_device_feels_no_force(examination: Examination) -> None:
    text = alone(examination, replace(examination.exchanges[0], where="/dev/ttyACM0"))
    assert "on /dev/ttyACM0, sent zero force; clock: device" in text
    assert "this machine keeps" not in text
    assert "the mock" not in text
    assert "No setting of this machine needs a change." in text


def test_no_rate_is_refused_of_which_nothing_is_known(examination: Examination) -> None:
    text = alone(examination, Exchanges(1000.0, "host", MOCK, None, None, None, "the mock is gone"))
    assert "With clock: host there is no verdict for any of these rates." in text
    assert "this machine keeps" not in text


def test_a_terminal_without_unicode_gets_none(examination: Examination) -> None:
    assert "20.5 us" in shown(examination, encoding="ascii")


def test_the_document_is_plain_and_has_no_nan(examination: Examination) -> None:
    made = plain(examination_document(examination))
    assert json.loads(document(made)) == json.loads(json.dumps(made, allow_nan=False))
    wakeups = made["wakeups"]
    assert [entry["rate_hz"] for entry in wakeups] == [1000.0, 4000.0]
    assert wakeups[0]["lateness"]["count"] == 1011
    assert wakeups[1]["lateness"]["p50_s"] is None
    assert [run["failure"] for run in made["exchanges"][:2]] == [None, "the mock is gone"]
    assert made["best_rates_hz"] == {"device": 1000.0, "host": None}
    assert made["grants"][1] == {"privilege": "memory locked", "granted": False, "detail": "a limit"}
    bins = wakeups[0]["lateness"]["bins_from_s_to_s_count"]
    assert [count for *_, count in bins] == [1000, 10, 1]
    for (low, high, _), value in zip(bins, (20e-6, 80e-6, 3e-3), strict=True):
        assert low <= value < high


def test_rows_hold_every_count_side_by_side(histogram: Counted) -> None:
    generator = np.random.default_rng(1)
    for octaves in (1.0, 4.0, 12.0, 30.0):
        values = 1e-9 * 2.0 ** generator.uniform(0.0, octaves, 200)
        rows = histogram_rows(histogram(dict.fromkeys(values.tolist(), 3)))
        assert sum(row.count for row in rows) == 600
        assert 1 <= len(rows) <= octaves + 1
        assert all(row.ends == after.begins for row, after in pairwise(rows))
        assert rows[0].count > 0
        assert rows[-1].count > 0


def test_marks_stand_where_their_values_are_in_rows_of_an_octave(histogram: Counted) -> None:
    rows_of_two = histogram_rows(histogram({20e-6: 1, 60e-6: 1}))
    assert [row.ends / row.begins for row in rows_of_two] == pytest.approx([2.0, 2.0])
    made = histogram({20e-6: 1000, 80e-6: 10, 3e-3: 1})
    rows = {mark: row for row in histogram_rows(made, {"a period": 1e-3, "far off": 10.0}) for mark in row.marks}
    assert set(rows) == {"p50", "p99", "99.9 %", "max", "a period"}
    assert [rows[mark].count for mark in ("p50", "99.9 %", "max")] == [1000, 10, 1]
    assert rows["a period"].begins <= 1e-3 < rows["a period"].ends
    edge = histogram_rows(made)[1].begins
    assert [row.begins for row in histogram_rows(made, {"edge": edge}) if "edge" in row.marks] == [edge]


def test_one_in_a_hundred_thousand_has_a_bar(histogram: Counted) -> None:
    lines = histogram_lines(histogram({20e-6: 100_000, 3e-3: 1}), 80)
    bars = [line.count("█") for line in lines]
    assert bars[0] == max(bars)
    assert 4 <= bars[-2] <= bars[0] / 5
    assert set(bars[1:-2]) == {0}
    assert "logarithmic" in lines[-1]


def test_values_of_zero_and_the_last_bin_without_an_end_have_rows_of_their_own(histogram: Counted) -> None:
    rows = histogram_rows(histogram({0.0: 5, 1e-9: 2}))
    assert [(row.begins, row.count) for row in rows] == [(0.0, 5), (1e-9, 2)]
    assert histogram_lines(histogram({0.0: 5}), 80)[0].startswith(" 0 █")
    assert histogram_lines(histogram({}), 80) == ["nothing was counted"]
    made = histogram({1.0: 1})
    counts = made.counts.copy()
    counts[-1] = 7
    last = histogram_rows(replace(made, counts=counts, maximum=1e5))[-1]
    assert (last.count, last.ends) == (7, made.edges[-1])


@pytest.mark.parametrize("width", [40, 80, 120])
def test_lines_of_a_histogram_fit_and_are_ascii_where_asked(histogram: Counted, width: int) -> None:
    made = histogram({20e-6: 123_456_789, 30e-6: 12, 3e-3: 1})
    assert max(map(len, histogram_lines(made, width)[:-1])) <= max(width, 60)
    assert all(line.isascii() for line in histogram_lines(made, width, ascii_only=True))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(None, "–"), (0.0, "0"), (1e-9, "1 ns"), (9.999e-7, "1 µs"), (1.5e-3, "1.5 ms"), (2.0, "2 s"), (5e-10, "0.5 ns")],
)
def test_durations_in_words(seconds: float | None, text: str) -> None:
    assert short_duration(seconds) == text


def test_curves_fall_from_all_to_the_last_one(examination: Examination) -> None:
    curves = steadiness(examination)
    assert [(curve.what, curve.rate_hz, curve.clock) for curve in curves] == [
        ("lateness", 1000.0, ""),
        ("exchange", 1000.0, "device"),
    ]
    for curve in curves:
        assert curve.share[0] == 1.0
        assert curve.share[-1] == pytest.approx(1 / 1011)
        assert np.all(np.diff(curve.share) <= 0.0)
        assert np.all(np.diff(curve.time) > 0.0)
        assert curve.time[-1] == pytest.approx(3e-3)


def test_no_time_is_reported_too_short(histogram: Counted, examination: Examination) -> None:
    values = [1e-6 * (1.1**i) for i in range(50)]
    made = histogram(dict.fromkeys(values, 1))
    (curve, *_) = steadiness(replace(examination, wakeups={1000.0: made}))
    for t, share in zip(curve.time, curve.share, strict=True):
        assert sum(value >= t * (1 - 1e-6) for value in values) / 50 <= share + 1e-12


def test_the_picture_is_drawn_and_its_numbers_are_plain(examination: Examination, tmp_path: Any) -> None:
    curves = steadiness(examination)
    draw_steadiness(curves, "a title", tmp_path / "picture.svg")
    assert (tmp_path / "picture.svg").stat().st_size > 1000
    made = columns(curves)
    assert list(made) == ["what", "clock", "rate_Hz", "longer_than_s", "share"]
    assert len({len(column) for column in made.values()}) == 1
    assert all(math.isfinite(value) for name in ("longer_than_s", "share") for value in made[name])


def test_progress_is_a_line_a_measurement_without_a_terminal() -> None:
    stream = io.StringIO()
    with live_words(Console(file=stream, width=20)) as show:
        for number in (1, 1, 2):
            show(now(Step(number, 2, "wake-ups at 4 kHz", 0.5, 2.0, "")))
    assert stream.getvalue() == "1 of 2: wake-ups at 4 kHz: 0.5 of 2 s\n2 of 2: wake-ups at 4 kHz: 0.5 of 2 s\n"
