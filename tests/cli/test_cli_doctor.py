"""`hapsim doctor`, and the options that make a run steadier: what is printed and returned, never how fast."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hapsim.doctor import examine
from hapsim.doctor.advice import Advice
from hapsim.stopping import ignore_stops

Hapsim = Callable[..., Any]
SceneFile = Callable[..., Path]

ADVICE = Advice("The test was slow.", "It waits.", "Make it quicker:", ("pytest --quick",))
QUICK = ("--seconds", 0.05, "--rates", "200")
MEASURES = {"garbage collector frozen", "memory locked", "power saving off", "one processor", "SCHED_FIFO"}


@pytest.fixture
def advised(monkeypatch: pytest.MonkeyPatch) -> None:
    """One piece of advice, whatever the machine is like."""
    monkeypatch.setattr(examine, "advice_on", lambda _: [ADVICE])


@pytest.mark.usefixtures("advised")
def test_the_doctor_prints_every_rate_a_verdict_and_advice(hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch) -> None:
    told = hapsim("doctor", *QUICK)
    assert told.status == 0
    for words in ("Wake-up latency of a sleeping thread", "200 Hz", "What would help", *ADVICE.commands):
        assert words in told.out
    for words in (ADVICE.found, f"{ADVICE.why} {ADVICE.do}"):
        assert words in told.out
    monkeypatch.setattr(examine, "advice_on", lambda _: [])
    assert "No setting of this machine needs a change." in hapsim("doctor", *QUICK).out


@pytest.mark.usefixtures("advised")
@pytest.mark.parametrize("json", [(), ("--json",)])
def test_a_doctor_that_is_stopped_prints_what_it_found_and_ends_with_130(
    hapsim: Hapsim, monkeypatch: pytest.MonkeyPatch, json: tuple[str, ...]
) -> None:
    monkeypatch.setattr(examine, "exchanges", lambda *_, **__: os.kill(os.getpid(), signal.SIGTERM))
    told = hapsim("doctor", *QUICK, *json)
    assert (told.status, "hapsim: stopped after 2 of 6 steps" in told.err) == (130, True)
    assert "before anything was armed" not in told.err
    if json:
        assert (told.document["stopped_after_steps"], len(told.document["wakeups"])) == (2, 2)
    else:
        assert "Wake-up latency of a sleeping thread" in told.out


@pytest.mark.usefixtures("advised")
def test_its_document_picture_and_numbers_hold_the_same(hapsim: Hapsim, tmp_path: Path) -> None:
    picture, data = tmp_path / "p.svg", tmp_path / "d.csv"
    document = hapsim("doctor", *QUICK, "--picture", picture, "--data", data, "--json").document
    assert document["machine"]
    assert {entry["rate_hz"] for entry in document["wakeups"]} == {200.0, 1000.0}
    (advice,) = document["advice"]
    assert Advice(**advice | {"commands": tuple(advice["commands"])}) == ADVICE
    assert picture.read_text(encoding="utf-8").startswith("<?xml")
    assert data.read_text(encoding="utf-8").count("\n") > 3


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--rates", "fast"), "--rates: found 'fast', expected a number"),
        (("--rates", "200,0"), "--rates: found 0 Hz, expected 1 to 100000 Hz"),
        (("--seconds", "0"), "--seconds: found 0, expected at least a period of 1000 Hz"),
        (("--port", "/dev/ttyNOPE7"), "--port: found no SCENE"),
        (("--picture", "p.txt"), "found the ending '.txt'"),
    ],
)
def test_a_wrong_call_of_the_doctor_is_an_error(hapsim: Hapsim, words: tuple[str, ...], sentence: str) -> None:
    refusal = hapsim("doctor", *words).refusal
    assert sentence in refusal
    assert refusal.count("\n") == 1  # nothing was measured before


def test_a_device_that_cannot_be_asked_is_status_3_before_anything_is_measured(
    hapsim: Hapsim, scene_file: SceneFile
) -> None:
    answer = hapsim("doctor", scene_file("spring", clock="device"), "--port", "/dev/null", *QUICK, "--json")
    assert answer.status == 3
    assert answer.sentence.startswith("/dev/null: ")
    assert "wake-ups" not in answer.err


def test_a_run_in_real_time_reports_what_was_granted(hapsim: Hapsim, scene_file: SceneFile) -> None:
    answer = hapsim("run", scene_file("spring"), "--duration", 0.1, "--realtime", "--json")
    assert answer.status == 0
    assert {grant["privilege"] for grant in answer.document["realtime"]} == MEASURES
    for measure in MEASURES:
        assert measure in answer.err


def test_a_run_reports_its_histograms_and_asks_for_no_privileges(hapsim: Hapsim, scene_file: SceneFile) -> None:
    document = hapsim("run", scene_file("spring"), "--duration", 0.1, "--json").document
    assert "realtime" not in document
    for key in ("lateness_s", "exchange_s", "age_samples"):
        assert document[key].keys() == {"count", "p50", "p99", "p999", "max"}
    assert document["age_samples"] == {"count": 100, "p50": 1.0, "p99": 1.0, "p999": 1.0, "max": 1.0}
    assert document["lateness_s"]["count"] == 0


def test_the_portable_loop_is_run_on_request(hapsim: Hapsim, scene_file: SceneFile) -> None:
    words = ("run", scene_file("spring"), "--transport", "terminal", "--duration", 0.1, "--portable", "--json")
    assert hapsim(*words).document["ticks"] == 100


def test_a_command_that_prints_what_it_has_is_not_stopped_again() -> None:
    """The handlers are put back after each test."""
    ignore_stops()
    signal.raise_signal(signal.SIGINT)
    signal.raise_signal(signal.SIGTERM)
