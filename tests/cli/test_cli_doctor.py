"""`hapsim doctor`, and the options that make a run steadier: what is printed and returned, never how fast."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

QUICK = ("--seconds", 0.05, "--rates", "200")
MEASURES = {
    "garbage collector frozen",
    "memory locked",
    "power saving off",
    "one processor",
    "SCHED_FIFO",
}


def test_the_doctor_tells_every_rate_a_verdict_and_advice(hapsim: Callable[..., Any]) -> None:
    told = hapsim("doctor", *QUICK)
    assert told.status == 0
    assert "How late a sleeping thread is woken up" in told.out
    assert "200 Hz" in told.out
    assert "What would help" in told.out


def test_its_document_holds_the_same(hapsim: Callable[..., Any]) -> None:
    document = hapsim("doctor", *QUICK, "--json").document
    assert document["machine"]
    assert {entry["rate_hz"] for entry in document["wakeups"]} == {200.0, 1000.0}
    assert document["advice"]


def test_its_picture_and_numbers_are_written(hapsim: Callable[..., Any], tmp_path: Path) -> None:
    picture, data = tmp_path / "p.svg", tmp_path / "d.csv"
    told = hapsim("doctor", *QUICK, "--picture", picture, "--data", data)
    assert told.status == 0
    assert str(picture) in told.out
    assert picture.read_text(encoding="utf-8").startswith("<?xml")
    assert data.read_text(encoding="utf-8").count("\n") > 3


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--rates", "fast"), "--rates: found 'fast', expected a number"),
        (("--rates", "0"), "expected"),
        (("--seconds", "0"), "expected"),
        (("--port", "/dev/ttyNOPE7"), "--port: found no SCENE"),
        (("--picture", "p.txt"), "found the ending '.txt'"),
    ],
)
def test_a_wrong_call_of_the_doctor_is_told(hapsim: Callable[..., Any], words: tuple[str, ...], sentence: str) -> None:
    answer = hapsim("doctor", *words)
    assert answer.status == 2
    assert sentence in answer.sentence


def test_a_run_in_real_time_tells_what_it_got(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    answer = hapsim("run", scene_file("spring"), "--duration", 0.1, "--realtime", "--json")
    assert answer.status == 0
    assert {grant["measure"] for grant in answer.document["realtime"]} == MEASURES
    for measure in MEASURES:
        assert measure in answer.err


def test_a_run_tells_its_histograms(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    document = hapsim("run", scene_file("spring"), "--duration", 0.1, "--json").document
    for key in ("lateness_s", "exchange_s", "age_samples"):
        assert document[key].keys() == {"count", "p50", "p99", "p999", "max"}
    assert document["age_samples"] == {"count": 100, "p50": 1.0, "p99": 1.0, "p999": 1.0, "max": 1.0}
    assert document["lateness_s"]["count"] == 0


def test_the_portable_loop_is_run_on_request(hapsim: Callable[..., Any], scene_file: Callable[..., Path]) -> None:
    words = ("run", scene_file("spring"), "--line", "terminal", "--duration", 0.1, "--portable", "--json")
    assert hapsim(*words).document["ticks"] == 100
