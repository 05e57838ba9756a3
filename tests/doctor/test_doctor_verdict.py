"""Verdicts on the share of forces in time, in words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from hapsim.doctor.exchanges import MOCK, Exchanges, Verdict, answer_for, best_rate, share_in_time, verdict_on


def run_of(report: Any, *, clock: Any = "device", where: str = MOCK, failure: str = "") -> Exchanges:
    rate = 1000.0 if report is None else report.nominal_rate_hz
    return Exchanges(rate, clock, where, report, None, None, failure)


@pytest.mark.parametrize(
    ("share", "sentence"),
    [
        (1.0, "4 kHz: yes, 100 % in time"),
        (0.9998, "4 kHz: yes, 99.98 % in time"),
        (0.9999999, "4 kHz: yes, 99.999 % in time"),
        (0.999951, "4 kHz: yes, 99.995 % in time"),
        (0.999, "4 kHz: yes, 99.90 % in time"),
        (0.9989, "4 kHz: with gaps, 99.89 % in time"),
        (0.95, "4 kHz: with gaps, 95.0 % in time"),
        (0.9499, "4 kHz: no, 95.0 % in time"),
        (0.713, "4 kHz: no, 71.3 % in time"),
        (0.0, "4 kHz: no, 0 % in time"),
        (None, "4 kHz: no verdict"),
    ],
)
def test_sentences_never_round_a_gap_away(share: float | None, sentence: str) -> None:
    assert Verdict(4000.0, "host", MOCK, answer_for(share), share).sentence == sentence


@pytest.mark.parametrize(
    ("told", "device_asks", "share"),
    [
        ({"ticks": 990, "deadline_misses": 5, "lost_frames": 10, "duration_s": 0.989}, True, 985 / 1000),
        ({"ticks": 900, "duration_s": 0.999}, False, 0.9),  # the host was too slow to ask
        ({"ticks": 900, "duration_s": 0.999}, True, 1.0),
        ({"ticks": 2, "deadline_misses": 5}, True, 0.0),
        ({"ticks": 0}, True, None),
    ],
)
def test_late_lost_and_unsent_forces_are_deadline_misses(
    report: Callable[..., Any], told: dict[str, Any], device_asks: bool, share: float | None
) -> None:
    assert share_in_time(report(**told), device_asks=device_asks) == share


def test_nothing_ran_is_nothing_known(report: Callable[..., Any]) -> None:
    assert run_of(None).share_in_time is None
    assert run_of(report(ticks=1, duration_s=0.0)).share_of_rate is None


def test_a_run_that_failed_is_never_a_yes(report: Callable[..., Any]) -> None:
    broken = verdict_on(run_of(report(), failure="the device went away"))
    assert broken.answer == "no"
    assert broken.sentence == "1 kHz: no, 100 % in time (the device went away)"
    assert verdict_on(run_of(None, failure="no such port")).answer == "no verdict"


def test_a_mock_that_does_not_keep_the_rate_allows_no_verdict(report: Callable[..., Any]) -> None:
    slow = report(ticks=900, duration_s=0.999)
    verdict = verdict_on(run_of(slow))
    assert verdict.answer == "no verdict"
    assert "the mock itself kept only 90.0 % of the rate" in verdict.sentence
    assert verdict_on(run_of(slow, where="/dev/ttyACM0")).answer == "yes"
    assert verdict_on(run_of(slow, clock="host")).answer == "no"


def verdicts(*answers: Any, clock: str = "host", where: str = MOCK) -> list[Verdict]:
    return [Verdict(1000.0 * (i + 1), clock, where, answer, None) for i, answer in enumerate(answers)]


def test_the_best_rate_is_the_last_before_the_first_gap() -> None:
    assert best_rate(verdicts("yes", "yes", "no"), "host") == 2000.0
    assert best_rate(verdicts("yes", "with gaps", "yes"), "host") == 1000.0
    assert best_rate(reversed(verdicts("yes", "yes", "no")), "host") == 2000.0
    assert best_rate(verdicts("no verdict", "yes"), "host") is None
    assert best_rate(verdicts("yes"), "device") is None
    assert best_rate(verdicts("yes", where="/dev/ttyACM0"), "host") is None
