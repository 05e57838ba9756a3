"""The example of an experiment: sixty trials, their tables and the fit, which finds the simulated observer again."""

from __future__ import annotations

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest

from tests.loaded_files import module_of

EXAMPLE = Path(__file__).parents[2] / "configs" / "experiment"
LEVELS = (700.0, 800.0, 900.0, 1100.0, 1250.0, 1400.0)  # N/m


def script(name: str) -> Any:
    return module_of(EXAMPLE / f"{name}.py")


def called(module: Any, monkeypatch: pytest.MonkeyPatch, *words: object) -> None:
    monkeypatch.setattr("sys.argv", ["script", *map(str, words)])
    module.main()


@pytest.mark.thorough
def test_the_fit_finds_the_observer_that_answered_the_trials(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, hapsim: Callable[..., Any]
) -> None:
    run_trials, fit = script("run_trials"), script("fit")
    record, (trials, events) = tmp_path / "answers.trace", (tmp_path / f"{name}.tsv" for name in ("trials", "events"))
    called(run_trials, monkeypatch, record, "--seed", 1)
    for table in (trials, events):
        assert hapsim("export", record, table).status == 0
    called(fit, monkeypatch, trials, events, tmp_path / "picture.png")
    read = pandas.read_csv(trials, sep="\t")
    assert sorted(read["touch.stiffness"]) == sorted(LEVELS * 10)
    assert (read["outputs.code"] == [LEVELS.index(one) + 1 for one in read["touch.stiffness"]]).all()
    found = fit.fitted(*fit.answers(trials, events))
    for (_, low, high), truth in ((found.equality(), run_trials.REFERENCE), (found.jnd(), run_trials.JND)):
        assert low < truth < high
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def test_a_record_of_answers_is_not_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record = tmp_path / "answers.trace"
    record.write_bytes(b"answers")
    with pytest.raises(SystemExit, match=r"answers\.trace: the file exists, expected a new one"):
        called(script("run_trials"), monkeypatch, record)
    assert record.read_bytes() == b"answers"


def test_the_intervals_of_the_fit_hold_as_often_as_they_claim() -> None:
    run_trials, fit, held = script("run_trials"), script("fit"), list[tuple[bool, bool]]()
    for seed in range(200):
        chance, stiffness = random.Random(seed), np.repeat(LEVELS, 10)
        answer = np.array([float(run_trials.is_answered_stiffer(one, chance)) for one in stiffness])
        try:
            found = fit.fitted(stiffness, answer)
        except SystemExit:  # by chance the answers have no exception
            continue
        intervals = (found.equality(), run_trials.REFERENCE), (found.jnd(), run_trials.JND)
        equality, jnd = (low < truth < high for (_, low, high), truth in intervals)
        held.append((equality, jnd))
    assert len(held) > 180
    assert (np.mean(held, axis=0) > 0.9).all(), np.mean(held, axis=0)
    assert (np.mean(held, axis=0) < 0.99).all(), np.mean(held, axis=0)


def test_answers_that_no_function_fits_are_refused() -> None:
    fit, stiffness = script("fit"), np.repeat(LEVELS, 10)
    with pytest.raises(SystemExit, match="all answers change at one stiffness"):
        fit.fitted(stiffness, (stiffness > 1000.0).astype(float))


def test_answers_of_one_kind_are_refused(tmp_path: Path) -> None:
    trials, events = tmp_path / "trials.tsv", tmp_path / "events.tsv"
    trials.write_text("trial\ttouch.stiffness\n1\t700\n")
    events.write_text("trial_type\tvalue\ntrial\t1\nmarker\tanswer 1\n")
    with pytest.raises(SystemExit, match="found 1 answers of one kind"):
        script("fit").answers(trials, events)
