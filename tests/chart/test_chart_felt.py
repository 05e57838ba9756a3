"""`hapsim chart felt`: what is asked for, and which part of it is felt, beside theory and mock point by point."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hapsim.chart.felt_chart import BOARD, DRAWN, DesiredPlane, Outcome, felt_by, felt_chart, limit_of
from hapsim.chart.hand import Hand
from hapsim.theory import Configuration
from hapsim.theory.interface import BoardLaw
from tests.chart.conftest import few_masses_and_delays

Chart = Callable[..., Any]
SceneFile = Callable[..., Path]
DEVICE = Configuration(mass=1.0, rate=1.0)
SMALL = DesiredPlane(np.array([0.001, 0.02, 0.7]), np.array([0.05, 0.6, 1.4]))


@pytest.fixture(scope="module")
def usual() -> Any:
    with pytest.MonkeyPatch.context() as monkeypatch:
        few_masses_and_delays(monkeypatch)
        return felt_chart(Hand("hand", None, DEVICE, math.nan, math.nan))


def test_none_is_felt_as_the_configuration_predicts() -> None:
    felt = felt_by("none", DEVICE, DEVICE, SMALL)
    for (i, j), error in np.ndenumerate(felt.error):
        k = SMALL.kappa[i]
        b = 2.0 * SMALL.ratio[j] * math.sqrt(k)
        found_k, found_b = DEVICE.equivalent(k, b)
        expected = max(abs(found_k - k) / k, abs(found_b - b) / max(b, 0.1 * math.sqrt(k)))
        assert error == (pytest.approx(expected) if math.isfinite(expected) else math.inf)


def test_the_law_on_the_board_is_felt_as_at_its_own_rate_whatever_the_delay() -> None:
    board, late = BoardLaw(10, 1, 1), replace(DEVICE, delay=2.5)
    quick = replace(DEVICE, rate=10.0 * DEVICE.rate)
    felt = felt_by(BOARD, late, late, SMALL, board)
    k, b = SMALL.desired(late)
    for place, error in np.ndenumerate(felt.error):
        found_k, found_b = quick.equivalent(k[place], b[place])
        expected = max(abs(found_k / k[place] - 1.0), abs(found_b - b[place]) / max(b[place], 0.1 * k[place] ** 0.5))
        assert error == (pytest.approx(expected, rel=1e-6) if math.isfinite(expected) else math.inf)
    assert felt.share(0.05) > felt_by("none", late, late, SMALL).share(0.05)


@pytest.mark.parametrize("delay", [0.0, 0.37, 2.5])
def test_poles_feel_right_wherever_there_is_a_simulated_pair(delay: float) -> None:
    late = replace(DEVICE, delay=delay)
    felt = felt_by("poles", late, late, SMALL)
    had = np.isfinite(late.simulated(*SMALL.desired(late))[0])
    assert 0 < np.count_nonzero(had) < had.size
    assert (felt.outcome[had] == Outcome.WITHIN_1).all()
    assert (felt.outcome[~had] == Outcome.OUT_OF_REACH).all()
    assert felt.share(0.1) == np.mean(had)


@pytest.mark.parametrize("device", [{}, {"hold": "impulse", "delay": 2.0}, {"sampling": "average", "delay": 1.5}])
def test_a_predictor_that_knows_the_mass_has_the_whole_plane(device: dict[str, Any]) -> None:
    declared = replace(DEVICE, **device)
    felt = felt_by("predictor", declared, declared, SMALL)
    assert felt.share(1e-6) == 1.0


def test_what_the_device_has_more_of_by_itself_does_not_count() -> None:
    declared = replace(DEVICE, friction=0.1, stiffness=0.01)
    felt = felt_by("none", declared, declared, SMALL)
    k, b = SMALL.desired(declared)
    asked = (k >= 0.01) & (b >= 0.1)
    assert ((felt.outcome == Outcome.NOT_ASKED) == ~asked).all()
    assert felt.share(math.inf) == 1.0
    assert felt.share(0.05) == np.mean(felt.error[asked] <= 0.05)


@pytest.mark.thorough
def test_the_better_correction_feels_more_and_the_mass_matters(usual: Any) -> None:
    none, poles, predictor, sensed = (usual.felt[name].share(0.05) for name in DRAWN)
    assert none < 0.1
    assert poles > 0.7
    assert predictor == usual.limit == 1.0
    here = np.flatnonzero(usual.mass_ratio == 1.0)[0]
    for name, share in (("poles", poles), ("predictor", predictor)):
        of_masses = usual.against_mass[name]
        assert of_masses[here] == pytest.approx(share, abs=0.02)  # of a coarser plane
        assert of_masses.argmax() == here
        assert usual.against_delay[name][np.flatnonzero(usual.delay == 1.0)[0]] == of_masses[here]
    assert (np.diff(usual.against_delay["poles"]) < 0.0).all()
    assert 0.5 < sensed < poles
    assert (np.diff(usual.against_mass["sensed"]) > -0.01).all()  # the heavier, the better: no mass is in it
    assert usual.against_mass["sensed"][0] > usual.against_mass["predictor"][0] + 0.2


def test_no_controller_has_what_swings_at_half_the_rate_or_faster(monkeypatch: pytest.MonkeyPatch) -> None:
    few_masses_and_delays(monkeypatch)
    slow = Configuration(mass=1.0, rate=1.0, stiffness=1.9)  # nothing softer can be asked for
    chart = felt_chart(Hand("hand", None, slow, math.nan, math.nan))
    assert chart.limit == 1.0
    assert chart.felt["predictor"].share(0.05) == 1.0
    fast = DesiredPlane(np.array([1.0, 20.0]), np.array([0.1, 0.9]))  # 20 swings at 4.4 and at 1.9 rad a sample
    assert limit_of(DEVICE, fast) == 0.75
    assert felt_by("predictor", DEVICE, DEVICE, fast).share(0.05) <= 0.75


@pytest.mark.usefixtures("coarse_felt")
def test_the_numbers_are_those_of_the_summary(chart: Chart, rows_of: Callable[[str], list[dict[str, str]]]) -> None:
    answer = chart("felt", "--normalised", "--delay", "2", "--data", "n.csv", "--picture", "p.png", "--json")
    assert answer.status == 0
    assert Path("p.png").read_bytes().startswith(b"\x89PNG")
    rows = rows_of("n.csv")
    for name in (*DRAWN, BOARD):
        plane, of_delays = (
            [float(row["error_or_share"]) for row in rows if (row["panel"], row["correction"]) == (panel, name)]
            for panel in ("plane", "delay")
        )
        for within in (0.01, 0.05, 0.1):
            share = np.mean([error <= within for error in plane])
            assert answer.document["share"][name][f"{within:g}"] == pytest.approx(share)
        assert answer.document["against_delay"][name] == of_delays


@pytest.mark.thorough
@pytest.mark.usefixtures("coarse_felt")
def test_a_scene_is_taken_as_it_is_written(chart: Chart, scene_file: SceneFile) -> None:
    """The scene's own correction is not applied twice. The text shows a table and the limit."""
    share = chart("felt", scene_file("spring"), "--json").document["share"]
    assert share["none"]["0.05"] < share["poles"]["0.05"] < share["predictor"]["0.05"] == 1.0
    answer = chart("felt", scene_file("spring", correction="predictor"))
    assert answer.status == 0
    for name in DRAWN:
        row = re.search(rf"{name} +│ +\S+ % │ +(\S+) %", answer.out)
        assert row is not None
        assert float(row[1]) == pytest.approx(100.0 * share[name]["0.05"], abs=0.6)
    assert re.search(r"[Aa]ny controller.* 100", answer.out)
    assert Path("felt.svg").exists()
